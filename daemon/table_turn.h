#pragma once
// How the table makes one turn and a little more, and the frames of a turn at constant speed with their angles.

#include <functional>
#include <string>

#include <tl/expected.hpp>

#include "acquisition/angle_timeline.h"
#include "acquisition/frame.h"
#include "acquisition/triangulation.h"
#include "daemon/frame_feed.h"
#include "daemon/scan_job.h"

namespace celadon {

/// How the turn is laid out: `profiles` angles a turn, and so many again for the closure test.
struct TurnLayout {
  TurnLayout(const ScanEquipment& equipment, int profiles_of_turn);
  int profiles;
  double pitch_rad;
  int overlap_profiles;
  double overlap_rad;
  double encoder_per_true;  ///< over a whole turn
  TableEncoder encoder;

  /// True angle from one of the encoder's angles to another, positive where that rises.
  double turned_rad(double from_encoder_rad, double to_encoder_rad) const {
    return encoder.direction * (encoder.table_rad(to_encoder_rad) - encoder.table_rad(from_encoder_rad));
  }
};

/// How far the table goes for one turn: angles of the encoder from where it stands.
struct TableWay {
  double speed_rad_per_s = 0, run_up_rad = 0, whole_rad = 0;
};
/// A frame every pitch. The run-up and the run-out keep the turn itself at constant speed.
TableWay way_of_sweep(const ScanEquipment& equipment, const TurnLayout& turn);
/// One step before the first profile, so that it is approached from the same side as all others.
TableWay way_of_steps(const TurnLayout& turn);

/// Whether the table's travel holds an angle of its encoder, rising from where it stands.
bool turn_fits_travel(const ScanEquipment& equipment, double target_rad);

/// "12.34 degrees"
std::string degrees_text(double rad);

/// A frame and where the table stood: encoder's angle, and true angle since the start of the turn.
using TakeFrame = std::function<tl::expected<void, ScanStop>(Frame frame, const FrameAngle& angle, double turned_rad)>;

/// Turns the table at constant speed and hands over the frames from the turn's begin to its end, overlap included. The
/// table may still run out when it returns.
tl::expected<void, ScanStop> sweep_table(const ScanEquipment& equipment, FrameFeed& feed, const TurnLayout& turn,
                                         const Triangulator& triangulator, const TakeFrame& take);

}  // namespace celadon
