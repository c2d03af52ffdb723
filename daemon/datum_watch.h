#pragma once
// The datum while a scan is captured: fiducials on the platter's rim and the lasers' lines beside the object, in every
// frame. What a centred round object cannot show, a moved laser or wrong steps, the datum does.

#include <array>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "acquisition/axis_stop.h"
#include "acquisition/calibration.h"
#include "acquisition/datum/datum_solver.h"
#include "acquisition/datum/platter_line.h"
#include "acquisition/frame.h"
#include "acquisition/laser_line.h"
#include "fitting/profile.h"

namespace celadon {

/// What was seen of the datum in a whole scan.
struct DatumEvidence {
  bool has_tags = false;                 ///< the calibration knows fiducials
  int frames = 0, frames_with_tags = 0;  ///< of the first turn; with three tags or more
  double sweep_rad_per_s = 0;            ///< speed of the table in it; 0: in steps
  std::optional<DatumReading> reading;
  /// The line of one laser, taken as if it were that of another (or its own).
  struct Line {
    int shining = 0, taken_as = 0;
    std::vector<PlatterHeight> heights;
  };
  std::vector<Line> lines;
};

class DatumWatch {
 public:
  /// @param stop  where head and lift stand in the turns that are watched
  DatumWatch(const Calibration& calibration, const CameraMode& mode, std::span<const int> lasers,
             const AxisStop& stop = {});
  ~DatumWatch();

  /// A picture with the laser off before the turn.
  void at_rest(std::span<const std::uint8_t> picture, double encoder_rad);
  /// A frame of the first turn. @param encoder_at  encoder's angle at the instant of a row
  void see(std::span<const std::uint8_t> picture, const std::function<double(double row)>& encoder_at,
           double turned_rad, double speed_rad_per_s);
  /// A frame with a laser on. @param dark  the mean of frames with it off
  void line(int laser, std::span<const std::uint8_t> picture, std::span<const std::uint8_t> dark);
  /// What became of it: where the object stands, the platter is not bare.
  void object(const Profile& profile);
  DatumEvidence result() const;

 private:
  /// Radius within which all but one in a thousand of the object's samples near the platter lie.
  double foot_radius_mm() const;
  std::vector<DatumSighting> all_sightings() const;

  const Calibration calibration_;
  const CameraMode mode_;
  std::unique_ptr<RimTagTracker> tracker_;  ///< none without fiducials
  std::vector<TagSighting> at_rest_;
  std::vector<DatumSighting> sightings_;  ///< of the turn
  int frames_ = 0, frames_with_tags_ = 0;
  std::uint64_t lit_frames_ = 0;
  double speed_rad_per_s_ = 0;
  struct Watched {
    int shining = 0;
    PlatterLine line;
  };
  std::vector<Watched> lines_;
  std::array<std::uint64_t, 512> radii_{};  ///< samples near the platter by their distance from the axis, 1 mm
};

}  // namespace celadon
