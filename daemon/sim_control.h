#pragma once
// Client of the virtual scanner's control socket (sim/CONTROL.md), and what the daemon needs of it: its clock in
// lock-step, and its truth. Nothing of a scan knows that there is a simulator behind these.

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>
#include <tl/expected.hpp>

#include "firmware_bridge/clock.h"

namespace celadon {

/// One connection. Used from one thread.
class SimControl {
 public:
  /// Connects to FOLDER/control.sock and checks the version of its hello.
  static tl::expected<std::unique_ptr<SimControl>, std::string> open(const std::string& folder);
  ~SimControl();
  SimControl(const SimControl&) = delete;
  SimControl& operator=(const SimControl&) = delete;

  const nlohmann::json& hello() const { return hello_; }
  bool lock_step() const { return hello_.value("lock_step", false); }

  /// One request, one answer. Errors: a refusal or a broken connection, one sentence.
  tl::expected<nlohmann::json, std::string> ask(const std::string& request);
  /// Many requests sent ahead of their answers. Refused ones are null in the result.
  tl::expected<std::vector<nlohmann::json>, std::string> ask_all(const std::vector<std::string>& requests);

 private:
  SimControl(std::string path, int fd) : path_(std::move(path)), fd_(fd) {}
  tl::expected<void, std::string> send(const std::string& text);
  tl::expected<nlohmann::json, std::string> receive();
  std::string lost(const char* operation, const char* cause) const;

  std::string path_;
  int fd_ = -1;
  std::string received_;
  nlohmann::json hello_;
};

/// Device time of a virtual scanner in lock-step: sleeping declares a wait, which is what lets time pass. Should the
/// simulator go away, time runs on in real time so that no wait hangs; the next device request reports the loss.
class SimClock final : public Clock {
 public:
  explicit SimClock(std::unique_ptr<SimControl> control) : control_(std::move(control)) {}
  std::int64_t now_ns() override;
  void sleep_until(std::int64_t time_ns) override;

 private:
  std::int64_t ask(const std::string& request);
  std::unique_ptr<SimControl> control_;
  MonotonicClock real_;
  std::int64_t newest_ns_ = 0, real_at_newest_ns_ = 0;
  bool lost_ = false;
};

}  // namespace celadon
