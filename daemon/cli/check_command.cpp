// celadon check: a scan of a known object judged against its certificate.

#include <cstdio>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <memory>
#include <string>

#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>

#include "daemon/checks/reference_check.h"
#include "daemon/cli/commands.h"
#include "daemon/cli/order_scan.h"
#include "daemon/files/atomic_file.h"

namespace celadon::cli {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

struct CheckArguments {
  std::string reference, result, output, server = kServer, scene;
  std::uint64_t seed = 1;
  int profiles = 1200;
  bool as_json = false;
};

std::string text_of(const ReferenceCheck& check) {
  const Reference& r = check.reference;
  char text[1024];
  std::snprintf(text, sizeof text,
                "reference   %s, diameter %.4f mm at %.1f degrees Celsius, expanded uncertainty %.4f mm (k = 2)\n"
                "measured    diameter %.4f mm, expanded uncertainty %.4f mm (k = 2); form %.4f mm, %.4f mm expected\n"
                "difference  %+.4f mm, normalised error %.2f (at most 1: they agree)\n"
                "verdict     %s\n",
                to_string(r.shape), r.diameter_then_mm(), r.temperature_C, check.U_reference_mm,
                check.measured.diameter_mm, check.U_mm, check.measured.form_mm, check.form_expected_mm,
                check.difference_mm, check.normalised_error, to_string(check.verdict));
  std::string all = text;
  for (const std::string& finding : check.findings) all += "            " + finding + "\n";
  return all;
}

/// Judges a folder of results and writes check.json. @returns the exit code
int judge_folder(const fs::path& folder, const Reference& reference, const fs::path& output, bool as_json) {
  const fs::path report_file = folder / "report.json";
  std::ifstream in(report_file, std::ios::binary);
  if (!in) return fail(2, "'" + report_file.string() + "' cannot be opened; name the folder of a finished scan");
  const json report = json::parse(std::string(std::istreambuf_iterator<char>(in), {}), nullptr, false);
  if (!report.is_object() || report.value("format", json()) != "celadon-report" || report.value("version", json()) != 1)
    return fail(2, "'" + report_file.string() + "' is no report of version 1; name the folder of a finished scan");
  const auto surface = read_surface_json(folder / "surface.json");
  if (!surface) return fail(2, surface.error());
  const auto check = check_reference(reference, *surface, report);
  if (!check) return fail(2, "'" + folder.string() + "': " + check.error());
  const std::string text = format_check(*check, report);
  if (const auto written = write_file_atomically(output / "check.json", text); !written)
    return fail(4, written.error().message);
  std::fputs((as_json ? text : text_of(*check) + "file        " + (output / "check.json").string() + "\n").c_str(),
             stdout);
  return check->verdict == ReferenceVerdict::refused ? 1 : 0;
}

int check(const CheckArguments& a) {
  const auto reference = parse_reference(a.reference);
  if (!reference) return fail(2, reference.error());
  std::error_code error;
  if (!a.result.empty()) {
    // A folder of the store holds its results in one of their own.
    const fs::path given = a.result, results = given / "results";
    const fs::path folder = fs::exists(results / "report.json", error) ? results : given;
    const fs::path output = a.output.empty() ? folder : fs::path(a.output);
    if (const int code = prepare_folder(output)) return code;
    return judge_folder(folder, *reference, output, a.as_json);
  }
  const fs::path folder = a.output.empty() ? "check" : a.output;
  if (const int code = prepare_folder(folder)) return code;
  fs::remove(folder / "report.json", error);  // of an earlier scan: this one may end without
  const json request{{"name", "reference"},
                     {"shape", to_string(reference->shape)},
                     {"profiles", a.profiles},
                     {"formats", json::array({"surface.json"})}};
  FollowOptions follow;
  follow.folder = folder;
  follow.json = a.as_json;
  const int code = order_scan({a.server, a.scene, a.seed, request}, follow);
  // A scan that failed its own checks is judged too, and refused for them.
  if (code != 0 && !(code == 1 && fs::exists(folder / "report.json", error))) return code;
  return judge_folder(folder, *reference, folder, a.as_json);
}

}  // namespace

void add_check_command(CLI::App& program, Run& run) {
  auto a = std::make_shared<CheckArguments>();
  auto* command = program.add_subcommand(
      "check",
      "Scan a known object and judge its diameter and form against its certificate: good, usable or refused.\n"
      "Exit code 1 where refused. Writes check.json.");
  command->option_defaults()->always_capture_default();
  command
      ->add_option("--reference", a->reference,
                   "SHAPE:D=MM,u=MM[,form=MM][,a=PER_K,T=C,uT=K]: cylinder or sphere, certified diameter at 20 degrees "
                   "Celsius, its standard uncertainty u (or U=MM: expanded, k = 2), form deviation, thermal expansion, "
                   "the object's temperature and its standard uncertainty")
      ->required();
  add_scanner_options(*command, a->server, a->scene, a->seed);
  command
      ->add_option("--result", a->result, "folder of a finished scan of the reference to judge instead of a new scan")
      ->excludes("--simulate");
  command->add_option("-o,--output", a->output,
                      "folder for check.json and the scan's files; default: that of --result, or ./check");
  command->add_option("--profiles", a->profiles, "a turn, 200 to 100000")->check(CLI::Range(200, 100000));
  command->add_flag("--json", a->as_json, "check.json on standard output");
  command->callback([a, &run] { run = [a] { return check(*a); }; });
}

}  // namespace celadon::cli
