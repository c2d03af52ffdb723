#pragma once
// What the fiducials on the platter, seen all through a scan, say of table and camera. Equations: README.md.

#include <optional>
#include <span>
#include <vector>

#include "acquisition/calibration.h"
#include "acquisition/datum/rim_tag_tracker.h"

namespace celadon {

/// One tag in one frame of a scan.
struct DatumSighting {
  TagSighting tag;
  double turned_rad = 0;  ///< since the start of the turn; of a frame before it: negative, by how far it is away. One a
                          ///< frame
};

struct DatumReading {
  int sightings = 0, tags = 0;
  double residual_px = 0;  ///< standard deviation of a coordinate about what is stated below, by the median
  /// How much further than the encoder says the table had turned, mean over each 64th of the turn.
  struct Angle {
    double turned_rad = 0, error_rad = 0;
  };
  std::vector<Angle> angles;
  double turn_error_rad = 0, turn_sd_rad = 0;  ///< of the end of the turn against its beginning
  double wander_rad = 0, wander_sd_rad = 0;    ///< largest distance of the angles from a straight line
  /// Of the beginning of the turn against the table at rest before it; nullopt: nothing was seen at rest.
  std::optional<double> start_error_rad;
  double start_sd_rad = 0;
  /// How far the picture of the platter lies from where it was calibrated, root mean square over its tags, in the
  /// eighth of the turn where that is most. A turn of the camera about the table's axis counts as the table's.
  double camera_px = 0, camera_sd_px = 0;
  double camera_at_rad = 0;    ///< middle of that eighth
  double camera_first_px = 0;  ///< of the first eighth
};

/// Least squares over all sightings (frame after frame), those far off reweighted; nullopt: too few to say anything
/// (three tags, in half of the eighths of the turn).
std::optional<DatumReading> read_datum(const Calibration& calibration, std::span<const DatumSighting> sightings);

}  // namespace celadon
