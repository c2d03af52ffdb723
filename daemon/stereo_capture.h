#pragma once
// Move, frame, match, profile, log, accumulate: a scan by stereo. No laser is switched on; the table stands for each
// picture, and pictures some steps apart are pairs. Why: acquisition/stereo/README.md.

#include <cstdint>
#include <deque>
#include <optional>
#include <string>
#include <vector>

#include <tl/expected.hpp>

#include "acquisition/stereo/stereo_profile.h"
#include "daemon/frame_feed.h"
#include "daemon/scan_capture.h"
#include "daemon/scan_preparation.h"

namespace celadon {

class StereoCapture {
 public:
  /// Borrows all of them.
  StereoCapture(const ScanEquipment& equipment, const ScanRequest& request, FrameFeed& feed);

  /// Before the scan: the pictures' noise, and one pair for what the object shows. Turns the table by one pair's angle.
  /// @returns one sentence where nothing can be matched: no texture, too dark, overexposed
  tl::expected<ScanPreparation, ScanStop> look();
  /// One turn in steps and what the last pairs need beyond it.
  /// @pre look() was done; tools.turn and tools.so_far are not looked at
  tl::expected<CaptureResult, ScanStop> turn(const CaptureTools& tools);

  /// Windows, pairs and what the calibration leaves unknown, so far.
  const StereoShare& share() const { return share_; }

 private:
  struct Picture {
    std::vector<std::uint8_t> bytes;
    double encoder_rad = 0;
    std::int64_t time_ns = 0;
  };
  tl::expected<Picture, ScanStop> picture_after(std::int64_t instant_ns);
  tl::expected<Picture, ScanStop> picture_at(double encoder_rad);
  /// Matches a pair, looking after the machine meanwhile.
  tl::expected<StereoPair, ScanStop> match(const Picture& first, const Picture& second);
  std::string nothing_found(const MatchCounts& m, double saturated) const;

  const ScanEquipment& equipment_;
  const ScanRequest& request_;
  FrameFeed& feed_;
  const double pitch_rad_;  ///< of the encoder, from picture to picture
  const int apart_;         ///< pictures of a pair, in pitches
  double sigma_rad_ = 0;    ///< of an angle of the standing table
  PictureNoise noise_;
  StereoShare share_;
};

}  // namespace celadon
