#include "acquisition/calibrate/time_verdict.h"

#include <cmath>
#include <numbers>
#include <string>

#include "acquisition/calibrate/step_judge.h"

namespace celadon::calibrate {
namespace {

/// At 36 degrees per second 0.3 ms are 0.01 degrees: 0.01 mm at a radius of 60 mm.
constexpr double kGood_ms = 0.3;
constexpr double kGoodBacklash_deg = 0.1;
constexpr double kToDegrees = 180 / std::numbers::pi;

std::string plus_minus(const Measured& value, double factor) {
  return figure(value.value * factor) + " +- " + figure(value.u * factor);
}

}  // namespace

CalibrationStep judge_time(const std::optional<TimeEstimate>& time, int height_px) {
  StepJudge judge("time");
  if (!time) {
    judge.say(Verdict::usable, "when frames are exposed was not measured: no sweeps at two speeds showed the board",
              "scan in steps, or calibrate again with the board standing over the middle of the platter");
    return judge.step();
  }
  const TimeModel& t = time->time;
  const double over_picture_ms = t.line_time_ns.u * height_px * 1e-6;
  const auto verdict = [](bool good) { return good ? Verdict::good : Verdict::usable; };
  const std::string more = "scan in steps, or calibrate again with the board larger in the picture";
  judge.say(verdict(time->together_ns * 1e-6 <= kGood_ms),
            std::to_string(time->sweeps) + " sweeps; from stamp to the middle of the exposure " +
                plus_minus(t.stamp_offset_ns, 1e-6) + " ms and " + plus_minus(t.exposure_factor, 1) +
                " exposures, together +- " + figure(time->together_ns * 1e-6) + " ms (good to " + figure(kGood_ms) +
                ")",
            more);
  judge.say(verdict(over_picture_ms <= kGood_ms),
            "line time " + plus_minus(t.line_time_ns, 1e-3) + " us, over the picture +- " + figure(over_picture_ms) +
                " ms (good to " + figure(kGood_ms) + ")",
            more);
  const Measured& play = time->backlash_rad;
  if (play.u > 0) {
    judge.say(verdict(std::abs(play.value) * kToDegrees <= kGoodBacklash_deg),
              "backlash " + plus_minus({std::abs(play.value), play.u}, kToDegrees) + " degrees (good to " +
                  figure(kGoodBacklash_deg) + ")",
              "have the table's gear seen to; scans turn one way only and do not feel it");
  }
  return judge.step();
}

}  // namespace celadon::calibrate
