// celadon scan, watch, status, cancel: clients of the daemon.

#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <string_view>

#include <CLI/CLI.hpp>

#include "daemon/cli/commands.h"
#include "daemon/cli/follow.h"
#include "daemon/cli/order_scan.h"
#include "daemon/http/http_client.h"
#include "daemon/usage_error.h"

namespace celadon::cli {
namespace {

using nlohmann::json;

struct ScanArguments {
  std::string server = kServer, scene, name, method = "laser", mode, shape = "cylinder", model = "auto";
  FollowOptions follow;
  std::uint64_t seed = 1;
  int profiles = 0;
  bool dry_turn = false;
  double tolerance_mm = 0, form_tolerance_mm = -1;
  std::string exposure = "0";
  std::vector<std::string> lasers = {"all"};
  std::vector<double> elevations_deg, lifts_mm;
  std::vector<int> degree = {3, 3};
  std::vector<std::string> formats;
};

// The lasers named; empty: all.
std::vector<int> lasers_of(const ScanArguments& a) {
  std::vector<int> lasers;
  for (const std::string& laser : a.lasers) {
    if (laser != "all") lasers.push_back(std::stoi(laser));
  }
  return lasers;
}

json request_of(const ScanArguments& a) {
  json request{{"method", a.method},      {"shape", a.shape},
               {"model", a.model},        {"tolerance_mm", a.tolerance_mm},
               {"degree_u", a.degree[0]}, {"degree_v", a.degree[1]}};
  if (!a.mode.empty()) request["mode"] = a.mode;
  if (a.profiles > 0) request["profiles"] = a.profiles;
  if (const auto lasers = lasers_of(a); !lasers.empty()) request["lasers"] = lasers;
  if (!a.elevations_deg.empty()) request["elevations_deg"] = a.elevations_deg;
  if (!a.lifts_mm.empty()) request["lifts_mm"] = a.lifts_mm;
  if (a.dry_turn) request["dry_turn"] = true;
  if (a.exposure == "auto") {
    request["exposure_ms"] = a.exposure;
  } else if (const double exposure_ms = std::stod(a.exposure); exposure_ms > 0) {
    request["exposure_ms"] = exposure_ms;
  }
  if (!a.name.empty()) request["name"] = a.name;
  constexpr std::string_view kMesh = "mesh:";
  if (a.name.empty() && !a.scene.empty())
    request["name"] =
        a.scene.starts_with(kMesh) ? std::filesystem::path(a.scene.substr(kMesh.size())).stem().string() : a.scene;
  if (a.form_tolerance_mm >= 0) request["form_tolerance_mm"] = a.form_tolerance_mm;
  if (!a.formats.empty()) request["formats"] = a.formats;
  return request;
}

int scan(const ScanArguments& arguments) {
  const std::vector<int> lasers = lasers_of(arguments);
  if (arguments.lasers.size() > 1 && !lasers.empty() && lasers.size() != arguments.lasers.size())
    return fail(2, "--lasers takes all or numbers; leave one of them out");
  const bool second = std::find(lasers.begin(), lasers.end(), 1) != lasers.end();
  return order_scan({arguments.server, arguments.scene, arguments.seed, request_of(arguments), second ? 2 : 1,
                     !arguments.elevations_deg.empty(), !arguments.lifts_mm.empty(), arguments.method == "stereo"},
                    arguments.follow);
}

// The scan under way, or the next one that begins; waits for a press of the button.
int watch(const std::string& server, const FollowOptions& options) {
  catch_interrupts();
  if (const int code = prepare_folder(options.folder)) return code;
  HttpClient client(server);
  std::uint64_t id = 0;
  while (id == 0) {
    const auto waited = client.events("/api/v1/events", [&](const std::string& name, const std::string& data) {
      const auto scan = json::parse(data, nullptr, false);
      if (name == "scan" && scan.is_object()) id = scan.value("id", std::uint64_t{0});
      return id == 0 && !interrupted();
    });
    if (interrupted()) return 130;
    if (!waited) return fail(3, waited.error());
  }
  return follow_scan(client, id, options);
}

int status(const std::string& server) {
  HttpClient client(server);
  const auto machine = client.get("/api/v1/device");
  if (!machine) return fail(3, machine.error());
  if (machine->status != 200) return refused(*machine);
  std::printf("%s\n", json::parse(machine->body).dump(2).c_str());
  for (const std::string kind : {"calibration", "scan"}) {
    const auto jobs = client.get("/api/v1/" + kind + "s");
    if (!jobs) return fail(3, jobs.error());
    const json list = json::parse(jobs->body);
    for (const auto& record : list[kind + "s"]) {
      std::printf("%s %llu  %-11s  %s  %s\n", kind.c_str(),
                  static_cast<unsigned long long>(record["id"].get<std::uint64_t>()),
                  record["state"].get<std::string>().c_str(), record.value("created", "").c_str(),
                  record.value("reason", "").c_str());
    }
  }
  return 0;
}

int cancel(const std::string& server, std::uint64_t id) {
  HttpClient client(server);
  const auto cancel_one = [&](const std::string& kind) {
    return client.post("/api/v1/" + kind + "/" + std::to_string(id) + "/cancel", json::object());
  };
  constexpr int kNotFound = 404;
  auto answer = cancel_one("scans");
  if (answer && answer->status == kNotFound) answer = cancel_one("calibrations");
  if (!answer) return fail(3, answer.error());
  return answer->status == 200 ? 0 : refused(*answer);
}

}  // namespace

void add_scan_command(CLI::App& program, Run& run) {
  auto a = std::make_shared<ScanArguments>();
  auto* command =
      program.add_subcommand("scan", "Scan an object and fetch its CAD files; with --simulate on a virtual scanner.");
  command->option_defaults()->always_capture_default();
  add_scanner_options(*command, a->server, a->scene, a->seed);
  command->add_option("-o,--output", a->follow.folder,
                      "folder for the files; default: they stay in the daemon's store");
  command->add_option("--name", a->name, "name of the object");
  command
      ->add_option("--method", a->method,
                   "laser: a line on the object; stereo: no laser, pictures of a textured object under even light that "
                   "are matched in pairs; a virtual scanner then has a texture on the object and a lamp")
      ->check(CLI::IsMember({"laser", "stereo"}));
  command->add_option("--mode", a->mode, "stop for each frame, or turn at constant speed")
      ->check(CLI::IsMember({"step", "sweep"}))
      ->default_str("sweep; step with stereo");
  command->add_option("--profiles", a->profiles, "a turn, 16 to 100000; with stereo the pictures of a turn, 36 to 720")
      ->check(CLI::Range(16, 100000))
      ->default_str("1200; 90 with stereo");
  command->add_flag("--dry-turn", a->dry_turn,
                    "only a quick turn and a report: is all of the object in view, is the exposure right, how long "
                    "will the scan take and how well will it measure");
  command
      ->add_option(
          "--exposure", a->exposure,
          "exposure time [ms]; 0: as the camera stands; auto: quick turns before the scan find what suits each "
          "part of the turn, and whether a second turn with another is needed")
      ->check(CLI::IsMember({"auto"}) | not_negative());
  command
      ->add_option(
          "--lasers", a->lasers,
          "a full turn with each, in this order: all that are calibrated, or numbers, as 0,1; a virtual scanner "
          "has a second one if it is named")
      ->delimiter(',')
      ->expected(1, 4)
      ->check(CLI::IsMember({"all", "0", "1", "2", "3"}));
  command
      ->add_option(
          "--elevations", a->elevations_deg,
          "elevations of the head [degrees], as 0,30: a full turn with each laser at each; default: at 0; a virtual "
          "scanner has the axis if they are named")
      ->delimiter(',')
      ->check(finite());
  command
      ->add_option(
          "--lifts", a->lifts_mm,
          "heights of the table's lift [mm], as 0,80: all elevations at each; default: at 0; a virtual scanner has "
          "the axis if they are named")
      ->delimiter(',')
      ->check(finite());
  command
      ->add_option("--shape", a->shape,
                   "base geometry: cylinder, sphere, composite (walls with shoulders, heads), auto: what the samples "
                   "ask for, or none: no surface, the samples are the result (profiles.log)")
      ->check(CLI::IsMember({"cylinder", "sphere", "composite", "auto", "none"}));
  command->add_option("--model", a->model, "how general the surface is")
      ->check(CLI::IsMember({"auto", "cylinder", "revolution", "translational", "general"}));
  command
      ->add_option("--tolerance", a->tolerance_mm,
                   "refine until 95 % of the errors are below it [mm]; 0: what the data carry")
      ->check(not_negative());
  command
      ->add_option(
          "--form-tolerance", a->form_tolerance_mm,
          "deviation from a simpler form that is accepted [mm]; negative: the calibration's systematic uncertainty")
      ->check(finite());
  command->add_option("--degree", a->degree, "degrees of the range function along z and theta, 1 to 5")
      ->expected(2)
      ->check(CLI::Range(1, 5));
  command->add_option("--formats", a->formats, "files to make; default: all")
      ->check(CLI::IsMember({"step", "stl", "ply", "surface.json"}));
  command->add_flag("--json", a->follow.json, "progress and report as lines of JSON");
  command->callback([a, &run] { run = [a] { return scan(*a); }; });
}

void add_watch_command(CLI::App& program, Run& run) {
  auto server = std::make_shared<std::string>(kServer);
  auto options = std::make_shared<FollowOptions>();
  auto* command = program.add_subcommand(
      "watch", "Follow the scan under way or the next one, started by whomever, and fetch its files.");
  command->option_defaults()->always_capture_default();
  command->add_option("--server", *server, kServerHelp);
  command->add_option("-o,--output", options->folder, "folder for the files; default: they stay in the daemon's store");
  command->add_flag("--json", options->json, "progress and report as lines of JSON");
  command->callback([=, &run] { run = [=] { return watch(*server, *options); }; });
}

void add_status_command(CLI::App& program, Run& run) {
  auto server = std::make_shared<std::string>(kServer);
  auto* command = program.add_subcommand("status", "State of the machine and the jobs of the daemon's store.");
  command->option_defaults()->always_capture_default();
  command->add_option("--server", *server, kServerHelp);
  command->callback([=, &run] { run = [=] { return status(*server); }; });
}

void add_cancel_command(CLI::App& program, Run& run) {
  auto server = std::make_shared<std::string>(kServer);
  auto id = std::make_shared<std::uint64_t>(0);
  auto* command = program.add_subcommand(
      "cancel", "End a scan or calibration that waits or runs: laser off, motor stopped, what was recorded kept.");
  command->option_defaults()->always_capture_default();
  command->add_option("ID", *id, "number of the scan or calibration")->required();
  command->add_option("--server", *server, kServerHelp);
  command->callback([=, &run] { run = [=] { return cancel(*server, *id); }; });
}

}  // namespace celadon::cli
