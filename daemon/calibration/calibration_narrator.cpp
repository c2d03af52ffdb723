#include "daemon/calibration/calibration_narrator.h"

#include "daemon/scan_stops.h"

namespace celadon {

void CalibrationNarrator::say_if_new(const std::string& sentence) {
  if (sentence != last_) say(sentence);
  last_ = sentence;
}

void CalibrationNarrator::on_look(const BoardLook& look) {
  std::string text = !look.found  ? "no board: " + look.problem
                     : look.known ? "board seen, a view like this was taken already"
                     : look.still ? "view taken"
                                  : "board seen, hold it still";
  text += " (" + std::to_string(look.views) + " of " + std::to_string(look.wanted) + " views)";
  if (!look.advice.empty()) text += ". " + look.advice;
  say_if_new(text);
}

void CalibrationNarrator::on_turn(int placement, int angle, int angles, bool found) {
  if (angle == 1) seen_ = 0;
  seen_ += found ? 1 : 0;
  if (angle < angles) return;
  say_if_new("placement " + std::to_string(placement + 1) + ": the board was seen at " + std::to_string(seen_) +
             " of " + std::to_string(angles) + " angles");
}

void CalibrationNarrator::on_passes(int placement, int frames) {
  say_if_new("placement " + std::to_string(placement + 1) + ": the board was seen in " + std::to_string(frames) +
             " frames while the table turned");
}

void CalibrationNarrator::on_stop(int, const AxisStop& stop, bool found) {
  say_if_new(text_of(stop) + (found ? ": the board was seen" : ": the board was not seen"));
}

}  // namespace celadon
