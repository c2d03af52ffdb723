#pragma once
// Faults by name: which are armed, and which will be at an instant of the device's clock, at an angle of the table or
// at a frame. CONTROL.md, "Faults".

#include <cstdint>
#include <functional>
#include <map>
#include <span>
#include <string>
#include <vector>

#include <tl/expected.hpp>

namespace celadon::sim {

/// One fault that can be injected.
struct FaultKind {
  const char* name;
  const char* meaning;
  const char* argument;  ///< its name and unit, empty if it takes none
  double default_value, least, most;
  enum class Lasts : std::uint8_t {
    once,   ///< an event: leaves nothing armed
    count,  ///< the argument is how often it strikes; 0: until cleared
    until_cleared
  } lasts;
};

/// Every fault.
std::span<const FaultKind> fault_kinds();
const FaultKind* find_fault(const std::string& name);

struct FaultOrder {
  const FaultKind* kind = nullptr;
  double value = 0;
  enum class When : std::uint8_t { time, angle, frame } when = When::time;
  std::int64_t at_ns = 0;        ///< device time; past: at once
  double at_deg = 0;             ///< position that the drive reports after homing, unwrapped: once it is reached
  std::uint64_t at_frame = 0;    ///< sequence in the running stream
  std::int64_t duration_ns = 0;  ///< 0: until cleared
};

/// Where numbers of an order are drawn from: a span LOW..HIGH stands for one of its numbers, by (seed, line).
struct FaultOrigin {
  std::int64_t start_ns = 0;  ///< device time that "at" counts from
  std::uint64_t seed = 0, line = 0;
};

/// Checks name and arguments. @returns one sentence with the bad value and what is allowed
tl::expected<FaultOrder, std::string> make_fault(const std::string& name, std::span<const std::string> arguments);
/// "NAME[,ARGUMENT][@SECONDS]" of the command line: seconds after the start of the device.
tl::expected<FaultOrder, std::string> parse_fault_option(const std::string& text, std::int64_t start_ns);
/// NAME [ARGUMENT] [at SECONDS | angle DEG | frame N] [for SECONDS], as in a plan.
tl::expected<FaultOrder, std::string> parse_fault_words(std::span<const std::string> words, const FaultOrigin& origin);
/// A plan: one order a line, # comments, "seed N" before the orders it is for. The error names the line.
tl::expected<std::vector<FaultOrder>, std::string> parse_fault_plan(const std::string& text, FaultOrigin origin);

class FaultPlan {
 public:
  void schedule(const FaultOrder& order) { orders_.push_back(order); }
  /// When an order or the end of a fault is due next.
  std::int64_t next_ns() const;
  /// Orders whose time has come; each once.
  std::vector<FaultOrder> due(std::int64_t now_ns);
  std::vector<FaultOrder> due_at_angle(double position_deg);
  std::vector<FaultOrder> due_at_frame(std::uint64_t sequence);
  /// Names of the faults whose duration is over; each once.
  std::vector<std::string> over(std::int64_t now_ns);

  void arm(const FaultOrder& order, std::int64_t now_ns = 0);
  void clear(const std::string& name) { armed_.erase(name); }
  bool armed(const std::string& name) const { return armed_.count(name) != 0; }
  double value(const std::string& name) const { return armed_.at(name).value; }
  /// True if a counted fault strikes now; counts it down.
  bool strikes(const std::string& name);
  std::vector<std::string> names_armed() const;

 private:
  struct Armed {
    double value = 0;
    bool limited = false;
    std::int64_t end_ns = INT64_MAX;
  };
  std::vector<FaultOrder> take(const std::function<bool(const FaultOrder&)>& due);

  std::vector<FaultOrder> orders_;
  std::map<std::string, Armed> armed_;
};

}  // namespace celadon::sim
