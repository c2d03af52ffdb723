#pragma once
// Closed poles of a sphere: the range has a value, a gradient and second derivatives there, six parameters in all,
// instead of three free rows of coefficients. Source: README.md, "Poles"; thesis (3.14).

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "fitting/base_arcs.h"
#include "fitting/range_space.h"

namespace celadon {

/// How a pole closes.
enum class PoleRule : std::uint8_t {
  jet,   ///< any tangent plane and curvature: value, gradient and second derivatives, six parameters
  level  ///< f0j = f1j = f00, as in the thesis (3.14): only normal to the axis, one parameter
};

/// Which ends of a pair of spaces are closed poles.
struct Poles {
  bool start = false, end = false;  ///< phi = 0, phi = pi
  PoleRule rule = PoleRule::jet;
  /// Rows of coefficients that a pole binds. @pre degree_u 1..5
  int rows(int degree_u) const { return degree_u == 1 ? 1 : rule == PoleRule::level ? 2 : 3; }
  bool any() const { return start || end; }
  bool operator==(const Poles&) const = default;
};

/// The free coefficients of a pair of spaces that closed poles allow: x = P y, where y holds a few parameters a pole
/// and the coefficients of all rows that no pole binds. P has orthonormal columns.
class PoleJets {
 public:
  /// `u` over BaseSurface::meridian(), `v` over `around`. Degree 1 along u is continuous only: one parameter a pole.
  /// @pre the first (last) three functions of u are B-splines: two intervals and more before the first joint
  PoleJets(const RangeSpace& u, const RangeSpace& v, const BaseArcs& around, Poles poles);

  int count_u() const { return count_u_; }
  int count_v() const { return count_v_; }
  /// Rows without a pole: [first_row(), last_row()).
  int first_row() const { return first_row_; }
  int last_row() const { return last_row_; }
  /// All entries of y.
  int unknowns() const;
  /// Parameters of both poles, and the free coefficients (count_u x count_v) of each: orthonormal.
  int parameters() const { return static_cast<int>(columns_.size()); }
  const Eigen::MatrixXd& column(int parameter) const { return columns_[static_cast<std::size_t>(parameter)]; }

 private:
  int count_u_ = 0, count_v_ = 0, first_row_ = 0, last_row_ = 0;
  std::vector<Eigen::MatrixXd> columns_;
};

}  // namespace celadon
