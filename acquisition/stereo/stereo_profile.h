#pragma once
// From two laser-off pictures of the table at two angles to a profile of scattered samples with covariances.

#include <cstdint>
#include <memory>
#include <span>
#include <string>

#include <tl/expected.hpp>

#include "acquisition/stereo/window_match.h"
#include "acquisition/triangulation.h"
#include "fitting/profile.h"

namespace celadon {

/// A picture of the standing table.
struct TablePicture {
  std::span<const std::uint8_t> bytes;
  double encoder_rad = 0;
  double sigma_rad = 0;  ///< standard uncertainty of that angle
};

/// The matching of one pair, a band of windows at a time: the caller may look after a machine in between.
class StereoPair {
 public:
  /// @returns one sentence where the angles are no pair (NormalPair::make)
  /// @pre both pictures are whole frames of this mode, and the calibration is of its size
  static tl::expected<StereoPair, std::string> begin(const Calibration& calibration, const ScanVolume& volume,
                                                     const CameraMode& mode, const PictureNoise& noise,
                                                     const TablePicture& first, const TablePicture& second);

  int bands() const;
  void match(int band);
  /// Samples of the bands so far: r, theta, z, covariance, order and table_angle_rad (half way between the pictures);
  /// the other fields are left.
  MatchCounts fill(Profile& profile) const;

  const NormalPair& geometry() const { return geometry_; }
  const std::vector<WindowMatch>& matches() const { return matches_; }

 private:
  StereoPair(const NormalPair& geometry, const ScanVolume& volume) : geometry_(geometry), volume_(volume) {}

  NormalPair geometry_;
  ScanVolume volume_;
  double first_sigma_rad_ = 0, second_sigma_rad_ = 0;
  std::unique_ptr<const LevelPicture> first_, second_;  ///< where the matcher finds them when this is moved
  std::unique_ptr<const WindowMatcher> matcher_;
  std::vector<WindowMatch> matches_;
  MatchCounts counts_;
};

}  // namespace celadon
