#pragma once
// The native range data of the scanner, in the scanner frame: right-handed, z the rotary axis upward, theta in [0, 2
// pi) counter-clockwise seen from +z. All lengths in millimetres, angles in radians, times in nanoseconds.

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

namespace celadon {

/// Covariance of one sample's (r, theta, z), symmetric 3x3: mm^2, mm rad, rad^2.
struct SampleCovariance {
  float rr = 0, rt = 0, rz = 0, tt = 0, tz = 0, zz = 0;
};

/// Colour of the surface at a sample, as the camera has it; black stands for "not known".
struct SampleColour {
  std::uint8_t red = 0, green = 0, blue = 0;
  bool known() const { return (red | green | blue) != 0; }
  bool operator==(const SampleColour&) const = default;
};

/// How the samples of a profile lie relative to each other.
enum class ProfileOrder : std::uint8_t {
  rows,      ///< consecutive rows of one camera frame: neighbours along the vector are neighbours on the surface
  scattered  ///< any order (a point cloud cut into pieces)
};

/// All samples of one camera frame and laser (or one piece of a point cloud). Structure of arrays: r_mm, theta_rad and
/// z_mm have the same length; covariance, row and colour are either empty or of that length too. Samples are
/// independent: never smoothed along the line.
struct Profile {
  std::uint32_t index = 0;  ///< number of the profile in the scan, from 0
  std::uint16_t pose = 0;   ///< rigid placement of the object this profile belongs to
  std::uint8_t laser = 0;   ///< number of the laser
  ProfileOrder order = ProfileOrder::rows;
  double lift_mm = 0;          ///< height of the lift axis
  double table_angle_rad = 0;  ///< table angle at the middle row's instant
  std::int64_t time_ns = 0;    ///< middle row's instant, host clock

  std::vector<double> r_mm;       ///< > 0
  std::vector<double> theta_rad;  ///< any real; equality modulo 2 pi
  std::vector<double> z_mm;
  std::vector<SampleCovariance> covariance;
  std::vector<std::uint16_t> row;
  std::vector<SampleColour> colour;

  std::size_t size() const { return r_mm.size(); }
};

/// A sequence of profiles that can be read from the start more than once: what a fit needs for its further passes.
class ProfileStream {
 public:
  virtual ~ProfileStream() = default;
  /// Go back to the first profile.
  virtual void rewind() = 0;
  /// The next profile, valid until the next call; nullptr after the last one.
  virtual const Profile* next() = 0;
};

/// Consecutive parts of one sequence, which may be read at the same time.
using ProfileParts = std::span<ProfileStream* const>;

}  // namespace celadon
