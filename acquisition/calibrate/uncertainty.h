#pragma once
// What the joint covariance says: of each number, and of what a scan will measure. README.md, (8) to (10).

#include <Eigen/Core>
#include <string>
#include <vector>

#include "acquisition/calibrate/bundle.h"

namespace celadon::calibrate {

/// A place on a laser's line on a board: where scans will be.
struct VolumePoint {
  std::size_t plane = 0;
  Eigen::Vector2d p_px;
  Eigen::Vector3d p_C;
};
/// Places on all lines in use, at most a few hundred for each laser.
std::vector<VolumePoint> volume_of(const Observations& observations, const Estimate& estimate);

class Uncertainty {
 public:
  /// @pre estimate.axis; the estimate is anchored() and the information was computed in its charts
  Uncertainty(const Estimate& estimate, SharedInformation information, std::vector<VolumePoint> volume);

  const SharedLayout& layout() const { return layout_; }
  /// Of the numbers of CALIBRATION.md: the encoder's scale in the place of the turn, elevation axis and lift in the
  /// scanner's frame; multiplied by inflation()^2.
  const Eigen::MatrixXd& covariance() const { return information_.covariance; }
  const SharedInformation& information() const { return information_; }
  std::vector<std::string> names() const;
  /// sqrt(chi-square / degrees of freedom) if that is more than chance gives, else 1.
  double inflation() const { return inflation_; }
  /// Standard uncertainty of the length of everything, relative.
  double scale() const;

  double plane_distance(std::size_t plane) const;

  // What follows can be had with the uncertainty of the scale, and as if the scale were known.
  enum class Scale { included, known };
  double of(int parameter, Scale scale = Scale::included) const;
  /// Standard deviation in the worst direction of two neighbouring parameters.
  double worst_of_two(int first, Scale scale = Scale::included) const;
  /// Of a radius measured by a laser, the largest over the volume; 0 without lines.
  double radius(Scale scale) const;
  /// Of the plane's place, across it, the largest over the volume.
  double plane_place(std::size_t plane, Scale scale) const;
  /// Of the distance between axis and laser plane over the heights of the volume, the largest.
  double axis_from_plane(std::size_t plane, Scale scale) const;
  /// Of the axis's place at the origin, in the worst direction.
  double axis_place(Scale scale) const;

 private:
  const Eigen::MatrixXd& covariance(Scale scale) const {
    return scale == Scale::included ? information_.covariance : known_scale_;
  }

  Estimate estimate_;
  SharedLayout layout_;
  SharedInformation information_;
  Eigen::MatrixXd known_scale_;
  std::vector<VolumePoint> volume_;
  double inflation_ = 1;
};

}  // namespace celadon::calibrate
