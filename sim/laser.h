#pragma once
// Laser diode: light comes up at once to most of its power and creeps to the rest, drifts a little, and goes out with a
// short delay.

#include <cmath>
#include <cstdint>

#include "sim/random.h"

namespace celadon::sim {

struct LaserConfig {
  double warm_up_share = 0.08;  ///< missing at switch-on
  double warm_up_time_s = 2;
  double drift_share = 0.01;  ///< amplitude of a slow oscillation
  double drift_period_s = 97;
  std::int64_t off_delay_ns = 300'000;
};

/// Power relative to nominal. Calls must not go back in time.
class Laser {
 public:
  explicit Laser(const LaserConfig& config, std::uint64_t seed = 0) : config_(config), seed_(seed) {}

  void enable(bool on, std::int64_t now_ns) {
    if (on && !enabled_) on_since_ns_ = now_ns < off_at_ns_ ? on_since_ns_ : now_ns;
    if (!on && enabled_) off_at_ns_ = now_ns + config_.off_delay_ns;
    enabled_ = on;
  }
  /// Faults: emits although disabled; emits nothing; is out for a share of the time, in moments of 8 ms.
  void set_stuck_on(bool stuck, std::int64_t now_ns) {
    if (stuck && !stuck_ && !enabled_) on_since_ns_ = now_ns;
    stuck_ = stuck;
  }
  void set_dead(bool dead) { dead_ = dead; }
  void set_flicker(double share) { flicker_ = share; }

  double power(std::int64_t now_ns) const {
    if (dead_ || (!enabled_ && !stuck_ && now_ns >= off_at_ns_)) return 0;
    if (flicker_ > 0 && random_uniform(make_key(seed_, kFlickerPurpose, 0), moment(now_ns)) < flicker_) return 0;
    const double on = static_cast<double>(now_ns - on_since_ns_) * 1e-9;
    const double warm = 1 - config_.warm_up_share * std::exp(-on / config_.warm_up_time_s);
    return warm * (1 + config_.drift_share *
                           std::sin(6.283185307179586 * static_cast<double>(now_ns) * 1e-9 / config_.drift_period_s));
  }
  bool enabled() const { return enabled_; }
  bool emits(std::int64_t now_ns) const { return power(now_ns) > 0; }

 private:
  static constexpr std::uint64_t kFlickerPurpose = 12;
  static std::uint32_t moment(std::int64_t now_ns) { return static_cast<std::uint32_t>(now_ns / 8'000'000); }

  LaserConfig config_;
  std::uint64_t seed_;
  double flicker_ = 0;
  bool enabled_ = false, stuck_ = false, dead_ = false;
  std::int64_t on_since_ns_ = 0, off_at_ns_ = INT64_MIN;
};

}  // namespace celadon::sim
