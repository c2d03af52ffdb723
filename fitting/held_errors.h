#pragma once
// What conditions that hold exactly, whatever the samples say, make of the errors of a fit.
// Source: README.md, "Standard deviations". Internal to fitting/.

#include <Eigen/Core>
#include <complex>
#include <vector>

#include "fitting/active_values.h"
#include "fitting/knot_selection.h"
#include "fitting/range_space.h"
#include "fitting/stencil_matrix.h"

namespace celadon {

class HeldErrors {
 public:
  /// Conditions on a fit that solved `system`, over the functions `along`; `knot_bias`: what the knots cannot follow,
  /// and of it what those around cannot.
  HeldErrors(std::vector<HeldAlong> conditions, const RangeSpace& along, const StencilMatrix& system,
             const Eigen::MatrixXd& knot_bias, const Eigen::MatrixXd& knot_bias_around);

  /// C'C, so heavily that the errors C x = 0 are all that is left.
  void weigh_into(StencilMatrix& system) const;
  /// Mean square of what the knots cannot follow at a place, given by its functions along and around, once the
  /// conditions have moved the surface by what the knots cannot follow of them (mm^2).
  double knots_square(const ActiveValues& of_u, const ActiveValues& of_v, double along) const;
  std::vector<double> heights() const;

 private:
  std::complex<double> wave(double along, int order) const;
  std::vector<HeldAlong> conditions_;
  RangeSpace along_;
  Eigen::MatrixXd bias_along_, bias_around_;
  Eigen::MatrixXd rows_;      // C, a row a condition
  Eigen::MatrixXd response_;  // of the coefficients to a condition's value, a column a condition
};

}  // namespace celadon
