#pragma once
// Faults by name: which are armed, and which will be at an instant of the device's clock.

#include <cstdint>
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
  bool counts_down;  ///< the argument is how often it strikes; 0: until cleared
};

/// Every fault.
std::span<const FaultKind> fault_kinds();
const FaultKind* find_fault(const std::string& name);

struct FaultOrder {
  const FaultKind* kind = nullptr;
  double value = 0;
  std::int64_t at_ns = 0;  ///< device time; past: at once
};

/// Checks name and arguments. @returns one sentence with the bad value and what is allowed
tl::expected<FaultOrder, std::string> make_fault(const std::string& name, std::span<const std::string> arguments);
/// "NAME[,ARGUMENT][@SECONDS]" of the command line: seconds after the start of the device.
tl::expected<FaultOrder, std::string> parse_fault_option(const std::string& text, std::int64_t start_ns);

class FaultPlan {
 public:
  void schedule(const FaultOrder& order) { orders_.push_back(order); }
  std::int64_t next_ns() const;
  /// Orders whose time has come; each once.
  std::vector<FaultOrder> due(std::int64_t now_ns);

  void arm(const FaultOrder& order) { armed_[order.kind->name] = {order.value, order.value > 0}; }
  void clear(const std::string& name) { armed_.erase(name); }
  bool armed(const std::string& name) const { return armed_.count(name) != 0; }
  double value(const std::string& name) const { return armed_.at(name).value; }
  /// True if a counted fault strikes now; counts it down.
  bool strikes(const std::string& name);

 private:
  struct Armed {
    double value = 0;
    bool limited = false;
  };
  std::vector<FaultOrder> orders_;
  std::map<std::string, Armed> armed_;
};

}  // namespace celadon::sim
