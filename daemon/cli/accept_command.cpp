// celadon accept: a scan of a certified artefact judged against the scanner's maximum permissible errors.

#include <cstdio>
#include <filesystem>
#include <memory>
#include <string>

#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>

#include "acquisition/calibration.h"
#include "daemon/checks/acceptance.h"
#include "daemon/cli/commands.h"
#include "daemon/cli/order_scan.h"
#include "daemon/cli/virtual_scanner.h"
#include "daemon/files/atomic_file.h"
#include "daemon/logged_points.h"

namespace celadon::cli {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

constexpr const char* kScene = "artefact";

struct AcceptArguments {
  std::string artefact, permissible, log, output = "accept", report, server = kServer;
  bool simulate = false, as_json = false;
  std::uint64_t seed = 1;
  int profiles = 1200;
};

tl::expected<Artefact, std::string> artefact_of(const AcceptArguments& a) {
  auto artefact = !a.artefact.empty() ? read_artefact(a.artefact) : [] {
    const auto text = output_of({program_beside("celadon-sim"), "truth", "--artefact"});
    return text ? parse_artefact(*text, "the virtual scanner's artefact") : tl::make_unexpected(text.error());
  }();
  if (artefact && !a.permissible.empty()) {
    if (const auto given = parse_permissible(a.permissible, artefact->permissible); !given) {
      return tl::make_unexpected(given.error());
    }
  }
  return artefact;
}

/// The log in the folder of a scan or of the store, or the log itself.
fs::path log_in(const fs::path& given) {
  std::error_code error;
  return fs::is_directory(given, error) ? given / "profiles.log" : given;
}

/// Judges the samples of a log. @returns the exit code
int judge_log(const Artefact& artefact, const fs::path& file, const fs::path& report, bool as_json) {
  auto log = ProfileLogReader::open(file);
  if (!log) return fail(2, log.error().message);
  const ScannedPoints points = logged_points(**log, 1);
  if (!(*log)->error().empty()) return fail(2, (*log)->error());
  const LogHeader& scan = (*log)->header();
  const auto& end = (*log)->end();
  if (!end || end->outcome != LogOutcome::complete)
    return fail(2, "'" + file.string() + "' is of a scan that did not end in order; scan the artefact again");
  const auto calibration = parse_calibration(scan.calibration, "the calibration in '" + file.string() + "'");
  if (!calibration) return fail(2, calibration.error().message);
  const auto measured = measure_artefact(artefact, points, *calibration);
  if (!measured) return fail(2, "'" + file.string() + "': " + measured.error());
  const Acceptance acceptance = judge_acceptance(artefact, *measured);
  const std::string text = format_acceptance(acceptance, scan, calibration->date);
  if (const auto written = write_file_atomically(report, text); !written) return fail(4, written.error().message);
  std::fputs((as_json ? text : acceptance_text(acceptance) + "file        " + report.string() + "\n").c_str(), stdout);
  return acceptance.passed() ? 0 : 1;
}

int accept(const AcceptArguments& a) {
  if (a.artefact.empty() && !a.simulate)
    return fail(2, "accept needs the artefact's certificate; name its file with --artefact (ARTEFACT.md)");
  const auto artefact = artefact_of(a);
  if (!artefact) return fail(2, artefact.error());
  const fs::path folder = a.output, report = a.report.empty() ? folder / "acceptance.json" : fs::path(a.report);
  if (a.log.empty() || a.report.empty()) {
    if (const int code = prepare_folder(folder)) return code;
  }
  if (!a.log.empty()) return judge_log(*artefact, log_in(a.log), report, a.as_json);
  std::error_code error;
  fs::remove(folder / "profiles.log", error);  // of an earlier scan: this one may end without
  FollowOptions follow;
  follow.folder = folder;
  follow.json = a.as_json;
  const json request{{"name", kScene}, {"shape", "none"}, {"profiles", a.profiles}, {"formats", json::array()}};
  const int code = order_scan({a.server, a.simulate ? kScene : "", a.seed, request}, follow);
  // A scan that failed its own checks is judged too, and does not pass.
  if (code != 0 && !(code == 1 && fs::exists(folder / "profiles.log", error))) return code;
  return std::max(code, judge_log(*artefact, folder / "profiles.log", report, a.as_json));
}

}  // namespace

void add_accept_command(CLI::App& program, Run& run) {
  auto a = std::make_shared<AcceptArguments>();
  auto* command = program.add_subcommand(
      "accept",
      "Scan a certified artefact (balls, a flat) and judge probing form and size, sphere spacing and flatness, in the\n"
      "manner of ISO 10360-3 and VDI/VDE 2634-3; not a certificate. Exit code 1 unless all that is judged conforms.\n"
      "Writes acceptance.json.");
  command->option_defaults()->always_capture_default();
  command->add_option(
      "--artefact", a->artefact,
      "the artefact's certificate, a file as ARTEFACT.md describes; with --simulate the exact one unless "
      "given");
  command->add_option("--mpe", a->permissible,
                      "maximum permissible errors in mm, CHARACTERISTIC=MM[,..] of form, form95, size, spacing, "
                      "flatness, flatness95; in place of those of the artefact's file");
  auto* simulate =
      command->add_flag("--simulate", a->simulate, "start a virtual scanner with an artefact and a daemon for it");
  command->add_option("--seed", a->seed, "of every random number of the virtual scanner");
  command->add_option("--server", a->server, kServerHelp);
  command
      ->add_option("--log", a->log,
                   "profiles.log of a finished scan of the artefact, or its folder, to judge instead of a new scan")
      ->excludes(simulate);
  command->add_option("-o,--output", a->output, "folder for acceptance.json and the scan's files");
  command->add_option("--report", a->report, "acceptance.json under this name instead");
  command->add_option("--profiles", a->profiles, "a turn, 200 to 100000")->check(CLI::Range(200, 100000));
  command->add_flag("--json", a->as_json, "acceptance.json on standard output");
  command->callback([a, &run] { run = [a] { return accept(*a); }; });
}

}  // namespace celadon::cli
