#pragma once
// Recordings of frames: a folder with an index. Grammar: REPLAY.md.

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include <tl/expected.hpp>

#include "acquisition/angle_timeline.h"
#include "acquisition/frame.h"
#include "acquisition/image_file.h"

namespace celadon {

/// One line of the index.
struct RecordedFrame {
  std::string file;  ///< inside the folder
  double table_angle_rad = 0, table_angle_sigma_rad = 0, table_speed_rad_per_s = 0;
  std::int64_t stamp_ns = 0, exposure_ns = 0;
  FrameUse use = FrameUse::turn;
  int laser = 0;  ///< whose turn it belongs to
  AxisStop stop;  ///< of that turn
  int line = 0;   ///< of index.csv
};

struct RecordingIndex {
  std::string camera;
  RecordedScan scan;
  bool simulated = false;
  Shutter shutter = Shutter::global;
  ColourChannel colour = ColourChannel::red;
  int yuyv_width_px = 0, yuyv_height_px = 0;  ///< of *.yuyv frames
  std::optional<ColourCoding> yuv;            ///< what their colours mean; nothing: they are not looked at
  int saturated_level = 0;                    ///< as in CameraMode
  std::vector<RecordedFrame> frames;          ///< at least one; scan.lasers and scan.stops follow from them
};

/// A text that names file, line, value and remedy.
tl::expected<RecordingIndex, std::string> parse_recording_index(const std::string& text, const std::string& name);
std::string format_recording_index(const RecordingIndex& index);

/// Writes frames as they come and the index at the end: a recording without index.csv was interrupted. GREY frames
/// become PGM, YUYV frames raw files, both bit for bit.
class RecordingWriter {
 public:
  /// @pre folder exists; an index in it is replaced by finish()
  RecordingWriter(std::filesystem::path folder, const CameraMode& mode, const RecordedScan& scan);
  /// @param angle  of the instant of the frame's middle row, encoder's
  /// @param laser  whose turn the frame belongs to, 0 .. 255
  /// @param stop   where the axes beside the table stand
  /// @pre frame is of the mode given; stamps rise
  tl::expected<void, CameraError> append(const Frame& frame, const AngleAtInstant& angle, FrameUse use, int laser = 0,
                                         const AxisStop& stop = {});
  /// Writes the index beside its name, syncs it and renames it.
  tl::expected<void, CameraError> finish();

 private:
  std::filesystem::path folder_;
  CameraMode mode_;
  RecordingIndex index_;
};

}  // namespace celadon
