#include <array>

#include "tests/integration/fault_matrix.h"

namespace celadon::testing {
namespace {

using Known = FaultCase::Known;

// clang-format off
const std::vector<FaultCase>& cases() {
  static const std::vector<FaultCase> kCases = {
      {"modbus-silent 1", Known::passes, {"no complete reply"}},
      {"modbus-silent", Known::named, {"no complete reply", "link is down"}, false, true},
      {"heartbeat-lost 1", Known::passes, {"no complete reply", "fell silent"}},
      {"heartbeat-lost", Known::named, {"no complete reply", "link is down"}, false, true},
      {"modbus-late 120", Known::passes, {}},
      {"modbus-late 700", Known::named, {"no complete reply", "link is down"}, false, true},
      {"modbus-corrupt 1", Known::passes, {"reply was broken"}},
      {"modbus-corrupt 0", Known::named, {"reply was broken"}, false, true},
      {"modbus-exception 4", Known::named, {"exception 4", "controller refused", "refused"}, false, true},
      {"modbus-exception 6", Known::named, {"exception 6"}, false, true},
      {"modbus-disconnect", Known::passes, {}},
      {"serial-noise 0.0005", Known::passes, {"no complete reply", "reply was broken"}, false, false, true},
      {"serial-noise 0.05", Known::named, {"no complete reply", "reply was broken", "exception"}, false, true, true},
      {"controller-reset", Known::named, {"restarted"}, true},
      {"controller-unplug", Known::named, {"link is down", "failed: "}, false, true},
      {"controller-unplug for 0.3", Known::passes, {"link is down"}},
      {"clock-step 300", Known::named, {"clock"}},
      {"clock-step 5000", Known::named, {"fell silent", "clock"}},
      {"clock-step -500", Known::named, {"failed its own check", "clock", "restarted"}},
      {"interlock-open", Known::named, {"interlock", "cover"}, true},
      {"interlock-open for 0.05", Known::named, {"interlock", "cover", "locked"}, true},
      {"emergency-stop", Known::named, {"emergency stop"}, true},
      {"remote-off", Known::passes, {"forbids a start from afar"}},
      {"button-stuck", Known::named, {"button"}},
      {"button-chatter 15", Known::named, {"button"}},
      {"motor-stall", Known::named, {"stalled"}},
      {"motor-slip -2", Known::no, {}},
      {"backlash 0.5", Known::no, {}},
      {"steps-wrong 1.01", Known::no, {}},
      {"encoder-slip 5", Known::named, {"encoder"}, false, false, false, true},
      {"laser-dead", Known::named, {"does not emit", "No laser line", "not shine"}},
      {"laser-flicker 0.3", Known::named, {"flicker", "does not emit", "brightness"}},
      {"laser-stuck-on", Known::named, {"emits although"}},
      {"laser-hidden", Known::named, {"although it is switched off"}},
      {"drop-frame 5", Known::passes, {"frames lost"}},
      {"duplicate-frame 5", Known::passes, {}},
      {"stale-frame 5", Known::no, {}},
      {"corrupt-frame 5", Known::passes, {"frames lost"}},
      {"corrupt-frame 0", Known::named, {"corrupt", "damaged"}},
      {"short-frame 5", Known::passes, {"frames lost"}},
      {"delay-frames 300", Known::passes, {}},
      {"delay-frames 5000", Known::named, {"no frame"}},
      {"stamp-step 400", Known::named, {"stamp", "clock"}},
      {"stamp-step -400", Known::passes, {"stamp", "clock"}},
      {"stamp-step 60000", Known::named, {"stamp", "clock"}},
      {"camera-unplug", Known::named, {"unplugged"}},
      {"camera-nudge 0.2", Known::no, {}},
      {"vibration 0.02", Known::no, {}},
      {"lights-on 6", Known::no, {}},
      {"object-slip 2", Known::no, {}},
      {"object-wobble 0.5", Known::no, {}},
      {"object-fall", Known::no, {}},
  };
  return kCases;
}
// clang-format on

constexpr std::array<FaultMoment, 9> kMoments{{
    {"idle", "", ""},
    {"preparing: warning", "preparing", "at 1"},
    {"preparing: homing", "preparing", "at 3"},
    {"preparing: background", "preparing", "frame 4"},
    {"preparing: laser warm-up", "preparing", "frame 20"},
    {"scanning: sweep", "preparing", "angle 120", true, true},
    {"scanning: step", "preparing", "angle 120", true, true, true},
    {"solving", "solving", "", false, true},
    {"exporting", "exporting", "", false, true},
}};

}  // namespace

std::span<const FaultCase> fault_cases() {
  return cases();
}
std::span<const FaultMoment> fault_moments() {
  return kMoments;
}

}  // namespace celadon::testing
