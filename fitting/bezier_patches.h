#pragma once
// A range function, or the difference of two, as one Bezier polynomial a rectangle of knots.
// Source: README.md, "Largest differences".

#include <cstddef>
#include <vector>

#include "fitting/base_arcs.h"
#include "fitting/bspline_basis.h"
#include "fitting/range_function.h"

namespace celadon {

class BezierPatches {
 public:
  explicit BezierPatches(const RangeFunction& f);
  /// a - b where both are, over the breaks of both; degrees are the larger ones.
  /// @throws std::invalid_argument if the bases, the frames or the arcs differ, or the bands have nothing in common
  BezierPatches(const RangeFunction& a, const RangeFunction& b);

  const BaseArcs& arcs() const { return arcs_; }
  int degree_u() const { return degree_u_; }
  int degree_v() const { return degree_v_; }
  /// Breaks along the base, as BaseSurface says, and of v, ascending; the joints of the arcs are among those of v.
  const std::vector<double>& along() const { return along_; }
  const std::vector<double>& v() const { return v_; }
  /// Bezier coefficients (mm) on [along[i], along[i + 1]] x [v[j], v[j + 1]]: (degree_u + 1) x (degree_v + 1), u along
  /// rows.
  const IntervalMatrix& patch(std::size_t i, std::size_t j) const { return patches_[j * (along_.size() - 1) + i]; }

 private:
  void add(const RangeFunction& f, double sign);
  BaseArcs arcs_;
  int degree_u_ = 0, degree_v_ = 0;
  std::vector<double> along_, v_;
  std::vector<IntervalMatrix> patches_;
};

}  // namespace celadon
