#pragma once
// What the samples' errors make of a fitted range function: the covariance of its coefficients, and from it the
// standard deviation of the range at any place. Source: README.md, "Standard deviations".

#include <Eigen/Core>
#include <cstddef>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "fitting/fit_ladder.h"
#include "fitting/held_errors.h"
#include "fitting/knot_selection.h"
#include "fitting/moment_grid.h"
#include "fitting/noise_correlation.h"
#include "fitting/normal_solver.h"
#include "fitting/stencil_matrix.h"

namespace celadon {

/// What the covariance of a solved member follows from; holds no sums.
struct ErrorSources {
  std::shared_ptr<const NormalEquations> equations;
  StencilMatrix noise;               ///< sum over the cells of s A, s the variance of a sample of weight 1 there (mm^2)
  double largest_variance = 0;       ///< of s
  double noise_variance = 0;         ///< the mean of s
  Inflation inflation;               ///< of the errors' correlation
  double smoothing = 0;              ///< weight of the bending energy that was solved with, relative to the traces
  Eigen::MatrixXd roughness;         ///< tau near each coefficient: root of the object's bending energy a coefficient
  Eigen::MatrixXd knot_bias;         ///< what the knots cannot follow, near each coefficient (mm)
  std::vector<HeldAlong> held;       ///< what holds exactly, all around
  Eigen::MatrixXd knot_bias_around;  ///< if something is held: of knot_bias, what the knots around cannot follow
};

/// Of coefficients that least squares give, bridged with kVanishingWeight where cells are empty: noise alike
/// everywhere, and knots that follow. @pre the equations outlive the result
ErrorSources even_error_sources(const NormalEquations& equations, const Eigen::MatrixXd& free, double noise_variance,
                                const Inflation& inflation);

/// The samples of a member.
struct MemberSamples {
  const MomentGrid& sums;
  const FitLadder& ladder;
  double noise_variance = 0;  ///< of one of weight 1, mm^2
  Inflation inflation;        ///< of their errors' correlation
  double profiles = 0;        ///< lines of them that share an angle and errors; infinite for scattered points
  bool stated = false;        ///< weights are those of stated covariances, and say where the noise is larger
};
ErrorSources error_sources(const MemberSamples& samples, LadderFit member);

/// The range (order 0) or its slope along the base (order 1) at one place, times a factor.
struct AlongTerm {
  double along;
  int order;
  double factor;
};

/// Covariance of the free coefficients, the pairs that share an interval: memory as the normal matrix. The error it
/// speaks of is that to the truth: what noise makes of the coefficients; where an energy smooths or bridges, the
/// truth's own bending that it takes away; and what the knots cannot follow. Systematic errors of the scanner are not
/// in it.
class CoefficientCovariance {
 public:
  /// Costs two factors and their inverses' entries: 10 ms for 67 x 32 unknowns, 0.9 s for 131 x 128.
  /// std::nullopt: the samples do not determine it.
  static std::optional<CoefficientCovariance> of(const ErrorSources& sources);

  /// Standard deviation of the range along the ray, mm, at (v, along): v as BaseArcs gives it, `along` as BaseSurface
  /// says, both clamped. A quadratic form of (p + 1)(q + 1) functions: 0.4 us.
  double sd_mm(double v, double along) const;
  /// The same at n points; arrays of length n.
  void evaluate(const double* v, const double* along, std::size_t n, double* sd_mm) const;
  /// Standard deviation of a sum of terms at one v. Coefficients that share no interval count as independent.
  /// @pre nothing is held
  double sd_mm(double v, std::span<const AlongTerm> terms) const;

  const FitSpace& space() const { return equations_->space(); }
  const StencilMatrix& entries() const { return entries_; }
  /// Heights at which the range itself is held.
  std::vector<double> held_heights() const { return held_ ? held_->heights() : std::vector<double>(); }

 private:
  CoefficientCovariance(std::shared_ptr<const NormalEquations> equations, StencilMatrix entries,
                        std::optional<HeldErrors> held)
      : equations_(std::move(equations)), entries_(std::move(entries)), held_(std::move(held)) {}
  std::shared_ptr<const NormalEquations> equations_;
  StencilMatrix entries_;
  std::optional<HeldErrors> held_;
};

}  // namespace celadon
