#pragma once
// An axis of limited travel as a machine, the head's elevation or the table's lift: trapezoids, an encoder of finite
// resolution, a reference mark, hard ends. It stands by itself without torque. Closed form in time between commands.

#include <cstdint>
#include <vector>

namespace celadon::sim {

/// Positions are rad or mm.
struct TravelAxisConfig {
  double lowest = 0, highest = 0;  ///< travel of the commands; 0, the reference, lies between
  double beyond = 0;               ///< the hard ends lie that much further out
  double max_speed = 0, max_acceleration = 0;
  double homing_speed = 0;
  double quantum = 0;  ///< of the encoder
  double settle_time_s = 0.1;
  double start = 0;  ///< where it stands at power-on
};

/// -10 to 70 degrees, 30 degrees/s.
TravelAxisConfig elevation_drive();
/// -150 to 150 mm, 40 mm/s.
TravelAxisConfig lift_drive();

/// The axis's own position counts from the reference mark; the encoder's is what the drive believes: the same only
/// after homing. Calls must not go back in time by more than 10 ms.
class TravelAxis {
 public:
  enum class Phase : std::uint8_t { standing, moving, settling };

  explicit TravelAxis(const TravelAxisConfig& config);

  /// Trapezoid to an encoder position. @pre standing; speed, acceleration > 0
  void move(double target, double speed, double acceleration, std::int64_t now_ns);
  /// Goes below the mark, wherever it stands, and up to it; the encoder's position is 0 there.
  void home(std::int64_t now_ns);
  /// Decelerates to standing.
  void stop(std::int64_t now_ns);
  /// Torque off: stops; the drive forgets that it met an end.
  void release(std::int64_t now_ns);

  double position(std::int64_t now_ns);
  double speed(std::int64_t now_ns);
  /// Whole steps.
  double encoder(std::int64_t now_ns);
  Phase phase(std::int64_t now_ns);
  bool index_found(std::int64_t now_ns);
  const TravelAxisConfig& config() const { return config_; }

  /// Faults: it blocks until unblocked; it sinks or is pushed, which the encoder sees; the encoder loses counts.
  void block(bool blocked, std::int64_t now_ns);
  void shift(double by, std::int64_t now_ns);
  void slip_encoder(double by) { encoder_offset_ += by; }
  /// Motion was demanded and did not come.
  bool stalled() const { return stalled_; }
  void clear_stall() { stalled_ = false; }
  /// It ran into a hard end.
  bool at_end() const { return at_end_; }

 private:
  struct Segment {  ///< constant acceleration from an instant on
    std::int64_t begin_ns;
    double position, speed, acceleration;
  };
  static Segment after(const Segment& segment, std::int64_t now_ns);
  Segment state(std::int64_t now_ns) const;
  void advance(std::int64_t now_ns);
  bool start(std::int64_t now_ns);
  void append(double duration_s, double acceleration);
  void append_trapezoid(double distance, double speed, double acceleration);
  void stand_at(double position);
  void halt(std::int64_t now_ns, double position);
  std::int64_t end_ns() const { return segments_.back().begin_ns; }

  TravelAxisConfig config_;
  std::vector<Segment> segments_;  ///< the last one stands
  double encoder_offset_;          ///< encoder = position + offset
  bool homing_ = false, homed_ = false, blocked_ = false, stalled_ = false, at_end_ = false;
};

}  // namespace celadon::sim
