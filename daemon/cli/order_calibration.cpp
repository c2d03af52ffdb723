#include "daemon/cli/order_calibration.h"

#include <cstdio>

#include <nlohmann/json.hpp>

#include "daemon/cli/commands.h"
#include "daemon/cli/confirm_key.h"
#include "daemon/cli/follow.h"
#include "daemon/cli/order_scan.h"
#include "daemon/http/http_client.h"

namespace celadon::cli {
namespace {

using nlohmann::json;

constexpr int kLookAgain_ms = 100;
constexpr int kMostFailures = 3;  // of requests in a row

std::string path_of(std::uint64_t id) {
  return "/api/v1/calibrations/" + std::to_string(id);
}

/// The record as it becomes, said on the terminal where it is new.
class Sayer {
 public:
  void look_at(const CalibrationRecord& now) {
    if (now.message != message_ && !now.message.empty()) tell_operator(now.message);
    message_ = now.message;
    if (now.state == ScanState::queued && !waits_) tell_operator("Other jobs come first; waiting ...");
    waits_ = now.state == ScanState::queued;
    if (now.state == ScanState::paused && now.step != step_) {
      tell_instruction(now.instruction);
      step_ = now.step;
    }
    if (now.state == ScanState::solving && !solves_) tell_operator("solving ...");
    solves_ = now.state == ScanState::solving;
  }

 private:
  std::string message_;
  int step_ = 0;
  bool solves_ = false, waits_ = false;
};

/// What the daemon says of a calibration, as far as a terminal shows it.
tl::expected<CalibrationRecord, std::string> fetch_record(HttpClient& client, std::uint64_t id) {
  const auto answer = client.get(path_of(id));
  if (!answer) return tl::make_unexpected(answer.error());
  try {
    const json body = json::parse(answer->body);
    if (answer->status != 200) return tl::make_unexpected(body.value("detail", answer->body));
    CalibrationRecord record;
    record.id = id;
    record.state = scan_state_from(body.at("state").get<std::string>()).value_or(ScanState::failed);
    record.failure = scan_failure_from(body.value("failure", "")).value_or(ScanFailure::device);
    record.reason = body.at("reason").get<std::string>();
    record.files = body.at("files").get<std::vector<std::string>>();
    read_calibration_findings(body, record);
    return record;
  } catch (const json::exception& error) {
    return tl::make_unexpected("the daemon's answer cannot be read (" + std::string(error.what()) +
                               "); do daemon and command line come from one build?");
  }
}

/// The record at its end, or why it is not known.
tl::expected<CalibrationRecord, std::string> accompany(HttpClient& client, std::uint64_t id) {
  ConfirmKey key;
  Sayer sayer;
  bool cancelled = false;
  int failures = 0;
  while (true) {
    auto now = fetch_record(client, id);
    if (!now && ++failures > kMostFailures) return now;
    if (now) {
      failures = 0;
      sayer.look_at(*now);
      if (is_final(now->state)) return now;
    }
    if (interrupted() && !cancelled) {
      cancelled = true;
      (void)client.post(path_of(id) + "/cancel", json::object());
    }
    // Enter belongs to the instruction that was shown; one that came too late confirms nothing.
    if (key.pressed_within(kLookAgain_ms) && now && now->state == ScanState::paused)
      (void)client.post(path_of(id) + "/confirm", json{{"step", now->step}});
  }
}

}  // namespace

void tell_operator(const std::string& text) {
  std::printf("%s\n", text.c_str());
  std::fflush(stdout);
}

void tell_instruction(const std::string& instruction) {
  tell_operator("> " + instruction + " Then press Enter, or the button on the machine.");
}

void tell_steps(const std::vector<StepVerdict>& steps) {
  for (const StepVerdict& step : steps) {
    std::printf("%-10s %-8s %s%s%s\n", step.name.c_str(), step.verdict.c_str(), step.finding.c_str(),
                step.remedy.empty() ? "" : " ", step.remedy.c_str());
  }
  std::fflush(stdout);
}

int order_calibration(const std::string& server, const CalibrationRequest& request,
                      const std::filesystem::path& output) {
  catch_interrupts();
  HttpClient client(server);
  const auto answer = client.post("/api/v1/calibrations", to_json(request));
  if (!answer) return fail(3, answer.error() + "; or name a machine without a daemon with --device and --camera");
  if (answer->status != 201) return refused(*answer);
  const auto id = json::parse(answer->body)["id"].get<std::uint64_t>();
  const auto record = accompany(client, id);
  if (!record) return fail(3, record.error());
  tell_steps(record->steps);
  if (record->state == ScanState::done) {
    if (!output.empty()) {
      if (const auto done = client.download(path_of(id) + "/files/calibration.toml", output); !done)
        return fail(4, done.error());
      tell_operator("calibration: " + output.string() + " (" + record->verdict + ")");
    }
    tell_operator("The daemon uses it from now on.");
    return 0;
  }
  const std::string its = "calibration " + std::to_string(id) + " " + to_string(record->state) + ": ";
  if (record->state == ScanState::cancelled) return fail(interrupted() ? 130 : 1, its + record->reason);
  const int code = record->failure == ScanFailure::system ? 4 : record->failure == ScanFailure::data ? 1 : 3;
  return fail(code, its + record->reason);
}

}  // namespace celadon::cli
