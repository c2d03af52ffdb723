#pragma once
// The rotary axis as a machine: trapezoidal and S-curve speed profiles of the motor, a table that follows through a
// flexible coupling, backlash, an encoder with finite resolution and one index mark. Closed form in time between
// commands.

#include <cstdint>
#include <vector>

namespace celadon::sim {

/// Where the encoder's disc lies off its centre.
constexpr double kEccentricPhase_rad = 0.8;

struct TurntableConfig {
  double max_speed_rad_per_s = 3.141592653589793;        ///< 180 deg/s
  double max_acceleration_rad_per_s2 = 17.453292519943;  ///< 1000 deg/s^2
  double homing_speed_rad_per_s = 1.0471975511966;       ///< 60 deg/s
  double homing_acceleration_rad_per_s2 = 6.981317007977;
  double resonance_hz = 25;                ///< of the table on its coupling
  double damping_time_s = 0.02;            ///< of that oscillation; 0: rigid
  double settle_time_s = 0.1;              ///< the drive reports settling this long after the motor stands
  double backlash_rad = 0;                 ///< play between motor and table; the encoder sits on the motor's side
  std::uint32_t encoder_counts = 144'000;  ///< per turn: 0.0025 deg
  double encoder_eccentricity_rad = 0;  ///< e: at encoder angle b the table is at b + e (sin(b + phase) - sin(phase))
  double start_angle_rad = 1.0;         ///< where the table stands at power-on, counted from the index
};

/// Angles in radians, unwrapped, counter-clockwise from above. The mechanical angle is 0 at the index mark; the
/// encoder's position is what the drive believes: mechanical only after homing. Calls must not go back in time.
class Turntable {
 public:
  enum class Phase : std::uint8_t { standing, moving, settling };

  explicit Turntable(const TurntableConfig& config);

  /// Trapezoid to an encoder position, with a jerk above 0 an S-curve. @pre standing; speed, acceleration > 0
  void move(double target_rad, double speed_rad_per_s, double acceleration_rad_per_s2, std::int64_t now_ns,
            double jerk_rad_per_s3 = 0);
  /// Searches the index, passes it, returns to it; the encoder's position is 0 there.
  void home(std::int64_t now_ns);
  /// Decelerates to standing.
  void stop(std::int64_t now_ns);
  /// Torque off: coasts to standing as a stop does.
  void release(std::int64_t now_ns) { stop(now_ns); }

  /// Where the table really is, by the index mark, and its speed.
  double table_angle_rad(std::int64_t now_ns);
  double table_speed_rad_per_s(std::int64_t now_ns);
  /// Of the motor's shaft: exactly 0 once it stands, while the table still swings on its coupling.
  double motor_speed_rad_per_s(std::int64_t now_ns) const { return motor(now_ns).speed; }
  /// What the drive reports: whole encoder counts.
  double encoder_rad(std::int64_t now_ns);
  double encoder_speed_rad_per_s(std::int64_t now_ns);
  Phase phase(std::int64_t now_ns);
  bool index_found(std::int64_t now_ns);
  double encoder_quantum_rad() const;

  /// Faults: the encoder loses counts; the motor blocks (it stands where it is until unblocked); steps are lost.
  void slip_encoder(double by_rad) { encoder_offset_ += by_rad; }
  void block(bool blocked, std::int64_t now_ns);
  /// Motion was demanded and did not come.
  bool stalled() const { return stalled_; }
  void clear_stall() { stalled_ = false; }
  /// Steps per radian are wrong by this factor: the table turns that much further than the encoder says, from here on.
  void set_gear_error(double factor, std::int64_t now_ns);
  /// The table slips on its drive; the encoder does not see it.
  void slip_table(double by_rad) { slip_ += by_rad; }
  /// Play between drive and table from now on.
  void set_backlash(double play_rad);

 private:
  struct Segment {  ///< constant jerk from an instant on
    std::int64_t begin_ns;
    double position, speed, acceleration, jerk = 0;
  };
  struct Change {  ///< of the acceleration, or of the jerk
    std::int64_t at_ns;
    double by;
  };
  struct State {
    double position, speed, acceleration;
  };
  void advance(std::int64_t now_ns);
  State motor(std::int64_t now_ns) const;
  State deflection(std::int64_t now_ns) const;
  double after_backlash(double motor_rad) const;
  void start(std::int64_t now_ns);
  void decelerate();
  State after(const Segment& segment, std::int64_t now_ns) const;
  void append(double duration_s, double acceleration, double jerk = 0);
  void append_trapezoid(double distance, double speed, double acceleration);
  void append_s_curve(double distance, double speed, double acceleration, double jerk);
  void stand_at(double position);
  std::int64_t end_ns() const { return segments_.back().begin_ns; }

  TurntableConfig config_;
  std::vector<Segment> segments_;      ///< last one stands
  std::vector<Change> jolts_, ramps_;  ///< jumps of the acceleration, and of the jerk
  double settled_jolts_ = 0;           ///< acceleration from changes whose oscillation is over
  double play_ = 0;                    ///< table minus motor, within +-backlash/2
  double gear_ = 1, slip_ = 0;         ///< table = gear * motor + slip + play
  double encoder_offset_ = 0;          ///< encoder position = motor position + offset
  double pending_zero_ = 0;
  bool homing_ = false, homed_ = false, blocked_ = false, stalled_ = false;
};

}  // namespace celadon::sim
