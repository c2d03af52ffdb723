#include "daemon/cli/follow.h"

#include <csignal>
#include <cstdio>
#include <fstream>
#include <nlohmann/json.hpp>
#include <system_error>

#include "daemon/checks/self_check.h"
#include "daemon/cli/commands.h"
#include "daemon/cli/progress_display.h"
#include "daemon/cli/summary.h"
#include "daemon/scan_state.h"

namespace celadon::cli {
namespace {

using nlohmann::json;

volatile std::sig_atomic_t interrupt_count = 0;

std::string scan_path(std::uint64_t id) {
  return "/api/v1/scans/" + std::to_string(id);
}

int fetch(HttpClient& client, const json& scan, const FollowOptions& options) {
  json report;
  std::string names;
  for (const auto& entry : scan["files"]) {
    const std::string name = entry;
    const std::string path = scan_path(scan["id"].get<std::uint64_t>()) + "/files/" + name;
    if (name == "report.json") {
      const auto answer = client.get(path);
      if (answer && answer->status == 200) report = json::parse(answer->body, nullptr, false);
    }
    if (options.folder.empty()) continue;
    if (const auto done = client.download(path, options.folder / name); !done) return fail(4, done.error());
    names += "  " + (options.folder / name).string() + "\n";
  }
  if (options.folder.empty()) names = "  in " + scan.value("folder", "") + "\n";
  if (options.json) {
    std::printf("%s\n", json{{"report", report},
                             {"folder", options.folder.empty() ? scan.value("folder", "") : options.folder.string()}}
                            .dump()
                            .c_str());
  } else if (report.is_object()) {
    std::printf("%s\n%sfiles\n%s", report.value("name", "object").c_str(), summary_of(report).c_str(), names.c_str());
  }
  for (const auto& check : scan.value("checks", json::array())) {
    if (check.value("verdict", "") == to_string(CheckVerdict::failed)) {
      return fail(
          1, "the scan is kept, but its check '" + check.value("name", "") + "' failed: " + check.value("cause", ""));
    }
  }
  return 0;
}

}  // namespace

void catch_interrupts() {
  struct sigaction action {};
  action.sa_handler = [](int) { interrupt_count = interrupt_count + 1; };
  sigaction(SIGINT, &action, nullptr);
  sigaction(SIGTERM, &action, nullptr);
}

bool interrupted() {
  return interrupt_count > 0;
}

int prepare_folder(const std::filesystem::path& folder) {
  if (folder.empty()) return 0;
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  if (error || !std::filesystem::is_directory(folder)) {
    return fail(4, "the folder '" + folder.string() + "' cannot be made: " +
                       (error ? error.message() : "a file of that name exists") + "; choose another with -o");
  }
  return 0;
}

int follow_scan(HttpClient& client, std::uint64_t id, const FollowOptions& options) {
  json last;
  bool cancelled = false;
  {
    ProgressDisplay display(options.json);
    int failures = 0;
    // The daemon repeats the present state at every change and at least each half second of a scan, so Ctrl-C is seen
    // soon.
    while (!(last.is_object() && is_final(*scan_state_from(last["state"].get<std::string>())))) {
      const auto followed = client.events(scan_path(id) + "/events", [&](const std::string&, const std::string& data) {
        last = json::parse(data, nullptr, false);
        if (last.is_object()) display.show(last);
        failures = 0;
        if (interrupted() && !cancelled) {
          cancelled = true;
          (void)client.post(scan_path(id) + "/cancel", json::object());
        }
        return true;
      });
      if (!followed && ++failures > 3) return fail(3, followed.error());
    }
  }
  const auto state = *scan_state_from(last["state"].get<std::string>());
  if (state == ScanState::done) return fetch(client, last, options);
  const std::string reason = last.value("reason", "");
  if (state == ScanState::cancelled) {
    return fail(interrupted() ? 130 : 1,
                "scan " + std::to_string(id) + " was cancelled" + (reason.empty() ? "" : ": " + reason));
  }
  const auto failure = scan_failure_from(last.value("failure", "")).value_or(ScanFailure::device);
  const int code = failure == ScanFailure::system ? 4 : failure == ScanFailure::data ? 1 : 3;
  return fail(code, "scan " + std::to_string(id) + " " + to_string(state) + ": " + reason);
}

}  // namespace celadon::cli
