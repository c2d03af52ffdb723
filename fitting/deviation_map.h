#pragma once
// The standard deviation of a fitted range all over its surface, small enough for a file.
// Source: README.md, "Standard deviations".

#include <Eigen/Core>
#include <cstddef>
#include <vector>

#include "fitting/base_surface.h"

namespace celadon {

class CoefficientCovariance;

/// Standard deviations (mm, along the ray) at nodes and bilinear between them.
class DeviationMap {
 public:
  DeviationMap() = default;
  /// @pre both lists ascend and have two nodes at least; sd_mm is along.size() x v.size(), not negative
  DeviationMap(std::vector<double> along, std::vector<double> v, Eigen::MatrixXd sd_mm);

  /// Nodes along the base, as BaseSurface says, from rim to rim; and around, from 0 to the number of arcs.
  const std::vector<double>& along() const { return along_; }
  const std::vector<double>& v() const { return v_; }
  const Eigen::MatrixXd& sd_mm() const { return sd_mm_; }

  /// At (v, along), both clamped.
  double operator()(double v, double along) const;
  /// The same at n points; arrays of length n.
  void evaluate(const double* v, const double* along, std::size_t n, double* sd_mm) const;
  /// Of the nodes.
  double largest() const { return sd_mm_.size() > 0 ? sd_mm_.maxCoeff() : 0; }
  /// Over angle and height, on a sphere over the directions.
  double mean(const BaseSurface& base) const;

 private:
  std::vector<double> along_, v_;
  Eigen::MatrixXd sd_mm_;
};

/// Of a fit over the band [start, end] of its space: nodes at the knots and between them, values in three digits,
/// rounded up. Between the nodes it differs from the covariance by a few per cent of itself.
DeviationMap deviation_map(const CoefficientCovariance& covariance, double start, double end);

}  // namespace celadon
