// Result files: every number comes back, fields are as documented, and a folder appears whole or not at all.

#include "daemon/results.h"

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>
#include <bit>

#include <bit>
#include <cmath>
#include <csignal>
#include <set>

#include <nlohmann/json.hpp>

#include "daemon/surface_json.h"
#include "tests/build_paths.h"
#include "tests/temporary_folder.h"

namespace celadon {
namespace {

using nlohmann::json;
using testing::read_file;
using testing::TemporaryFolder;

/// r = a + b cos(theta) built from coefficients at hand: degree (1, 1), enough for files.
RangeFit sample_fit(double a = 30, double b = 1.0 / 3) {
  BaseSurface base;
  base.band_start = 5;
  base.band_end = 65;
  Eigen::MatrixXd c(2, 5);
  c << a, a + b, a - b, a, a, a + 1, a + b, a, a + b, a + 1;
  RangeFit fit;
  fit.function = RangeFunction(base, 1, 1, {0, 0, 1, 1}, {0, 0, 1, 2, 3, 4, 4}, c);
  fit.surface = symbolic_product(fit.function);
  fit.report.points = 1000;
  fit.report.rejected = 3;
  fit.report.unfollowable = 2;
  fit.report.model = SurfaceModel::general;
  fit.report.degree_u = 1;
  fit.report.degree_v = 3;
  fit.report.control_points_u = fit.surface.count_u();
  fit.report.control_points_v = fit.surface.count_v();
  fit.report.noise_mm = 0.02;
  fit.report.kappa = 1.25;
  fit.report.residual_mm = {0.02, 0.04, 0.1};
  fit.report.geometric_mm = {0.019, 0.039, 0.09};
  fit.report.sd_mean_mm = 0.001;
  fit.report.sd_max_mm = 0.004;
  fit.report.coverage = 1;
  fit.report.decided_by = "tolerance";
  fit.report.stopped_by = "Cp";
  fit.report.z_start_mm = 5;
  fit.report.z_end_mm = 65;
  fit.report.warnings = {"first"};
  fit.geometric_errors = ErrorMap(base);
  fit.geometric_errors.add(2.5, 35, 0.01);
  return fit;
}

SurfaceFile sample_file() {
  const RangeFit fit = sample_fit();
  Eigen::MatrixXd sd(3, 2);
  sd << 0.001, 0.00123, 0.004, 0.005, 0, 1.0 / 3;
  return {
      {{fit.function, fit.surface, DeviationMap({5, 35, 65}, {0, 4}, sd)}}, "vase \"1\"", "2026-01-02T03:04:05Z", true};
}

TEST(SurfaceJson, EveryNumberComesBack) {
  const SurfaceFile file = sample_file();
  const std::string text = format_surface_json(file);
  const auto back = parse_surface_json(text, "surface.json");
  ASSERT_TRUE(back) << back.error();
  EXPECT_EQ(back->name, file.name);
  EXPECT_EQ(back->date, file.date);
  EXPECT_EQ(back->simulated, true);
  EXPECT_EQ(back->pieces.front().function.coefficients(), file.pieces.front().function.coefficients());
  EXPECT_EQ(back->pieces.front().function.knots_v(), file.pieces.front().function.knots_v());
  EXPECT_EQ(back->pieces.front().surface.control_points, file.pieces.front().surface.control_points);
  EXPECT_EQ(back->pieces.front().surface.knots_u, file.pieces.front().surface.knots_u);
  EXPECT_EQ(back->pieces.front().surface.degree_v, file.pieces.front().surface.degree_v);
  EXPECT_EQ(back->pieces.front().function.base().band_end, 65);
  const auto &map = back->pieces.front().deviation, &written = file.pieces.front().deviation;
  ASSERT_TRUE(map);
  EXPECT_EQ(map->along(), written->along());
  EXPECT_EQ(map->v(), written->v());
  EXPECT_EQ(map->sd_mm(), written->sd_mm());
  EXPECT_EQ(format_surface_json(*back), text);
}

TEST(SurfaceJson, SpheresComeBackToo) {
  BaseSurface base;
  base.kind = BaseKind::sphere;
  base.band_start = 0;
  base.band_end = 2;
  base.X_WB.translation() << 1, 2, 3;
  const RangeFunction whole(base, 0, 0, {0, 2}, {0, 4}, Eigen::MatrixXd::Constant(1, 1, 25));
  for (const RangeFunction& f : {whole, whole.clipped(0.25, 1.75)}) {
    const std::string text = format_surface_json({{{f, symbolic_product(f)}}, "ball", "", false});
    const auto back = parse_surface_json(text, "surface.json");
    ASSERT_TRUE(back) << back.error();
    EXPECT_TRUE(back->pieces.front().function.base().spherical());
    EXPECT_EQ(back->pieces.front().function.base().band_start, f.base().band_start);
    EXPECT_EQ(back->pieces.front().function.base().band_end, f.base().band_end);
    EXPECT_EQ(format_surface_json(*back), text);
    json damaged = json::parse(text);
    damaged["base"]["w_end"] = 2.5;
    EXPECT_NE(parse_surface_json(damaged.dump(), "s").error().find("base.w_end"), std::string::npos);
  }
}

TEST(SurfaceJson, RimsThatAreNotPlaneComeBackToo) {
  const RangeFunction plane = sample_fit().function;
  BaseSurface base = plane.base(), over = base;
  over.band_start = 4;
  over.band_end = 66;
  Eigen::MatrixXd rims(2, 5);
  rims << 4, 5, 4, 3, 4, 66, 66, 67, 1.0 / 3 + 65, 66;
  base.heights = std::make_shared<const RangeFunction>(over, 1, 1, plane.knots_u(), plane.knots_v(), rims);
  const RangeFunction f(base, 1, 1, plane.knots_u(), plane.knots_v(), plane.coefficients());
  const std::string text = format_surface_json({{{f, symbolic_product(f)}}, "bowl", "", false});
  const auto back = parse_surface_json(text, "surface.json");
  ASSERT_TRUE(back) << back.error();
  ASSERT_TRUE(back->pieces.front().function.base().heights);
  EXPECT_EQ(back->pieces.front().function.base().heights->coefficients(), rims);
  EXPECT_EQ(back->pieces.front().function.base().z_mm(1, 65), base.z_mm(1, 65));
  EXPECT_EQ(format_surface_json(*back), text);
  json damaged = json::parse(text);
  damaged["base"]["heights"]["upper_mm"][2] = 3;
  EXPECT_NE(parse_surface_json(damaged.dump(), "s").error().find("base.heights.upper_mm"), std::string::npos);
  damaged = json::parse(text);
  damaged["base"]["heights"]["along"][0] = 6;
  EXPECT_NE(parse_surface_json(damaged.dump(), "s").error().find("base.heights.along"), std::string::npos);
}

TEST(SurfaceJson, PiecesComeBackInTheirOrder) {
  SurfaceFile file = sample_file();
  BaseSurface base;
  base.kind = BaseKind::sphere;
  base.band_end = 1;
  base.X_WB.translation().z() = 65;
  const RangeFunction dome(base, 0, 0, {0, 1}, {0, 4}, Eigen::MatrixXd::Constant(1, 1, 30));
  file.pieces.push_back({dome, symbolic_product(dome)});
  const std::string text = format_surface_json(file);
  EXPECT_EQ(json::parse(text)["format"], "celadon-composite");
  const auto back = parse_surface_json(text, "surface.json");
  ASSERT_TRUE(back) << back.error();
  ASSERT_EQ(back->pieces.size(), 2u);
  EXPECT_FALSE(back->pieces[0].function.base().spherical());
  EXPECT_EQ(back->pieces[1].function.base().X_WB.translation().z(), 65);
  EXPECT_EQ(format_surface_json(*back), text);
  json damaged = json::parse(text);
  damaged["pieces"][1]["base"]["kind"] = "cone";
  EXPECT_NE(parse_surface_json(damaged.dump(), "s").error().find("pieces[1].base.kind"), std::string::npos);
  damaged["pieces"] = json::array();
  EXPECT_NE(parse_surface_json(damaged.dump(), "s").error().find("pieces has 0 pieces"), std::string::npos);
}

TEST(SurfaceJson, HoldsWhatTheGrammarNames) {
  const json j = json::parse(format_surface_json(sample_file()));
  EXPECT_EQ(j["format"], "celadon-surface");
  EXPECT_EQ(j["version"], 1);
  EXPECT_EQ(j["units"]["length"], "mm");
  EXPECT_EQ(j["base"]["kind"], "cylinder");
  EXPECT_EQ(j["base"]["arcs"], 4);
  // The quarter circle's middle weight is cos 45 degrees, its middle control point at (w, w).
  EXPECT_NEAR(j["base"]["control_points"][1][2], std::sqrt(0.5), 1e-15);
  EXPECT_NEAR(j["base"]["control_points"][1][0], std::sqrt(0.5), 1e-15);
  EXPECT_EQ(j["range_function"]["coefficients"][0][1], 30 + 1.0 / 3);
  EXPECT_EQ(j["base"]["frame"]["z"], json({0.0, 0.0, 1.0}));
}

TEST(SurfaceJson, NamesWhatIsWrong) {
  const json good = json::parse(format_surface_json(sample_file()));
  struct Case {
    const char* pointer;
    json value;
    const char* says;
  };
  const Case cases[] = {
      {"/version", 2, "version"},
      {"/format", "stl", "format"},
      {"/surface/degree_u", 99, "surface.degree_u is 99"},
      {"/surface/knots_u", json::array({0, 1}), "surface.knots_u"},
      {"/surface/knots_u/1", 0.5, "surface.knots_u"},
      {"/surface/control_points/0/0/3", 0, "surface.control_points[0][0]"},
      {"/surface/control_points/0", json::array(), "surface.control_points[0]"},
      {"/range_function/coefficients/1/2", "x", "range_function.coefficients[1][2]"},
      {"/range_function/knots_v/3", -1, "range_function.knots_v"},
      {"/base/kind", "torus", "base.kind"},
      {"/base/z_end_mm", -5, "base.z_end_mm"},
      {"/base/frame/z", json::array({0, 0, -1}), "base.frame"},
      {"/base/arcs", 7, "base.arcs"},
      {"/simulated", "no", "simulated"},
      {"/standard_deviation/sd_mm/2/1", -0.1, "standard_deviation.sd_mm[2]"},
      {"/standard_deviation/sd_mm/0", json::array({1}), "standard_deviation.sd_mm[0]"},
      {"/standard_deviation/along/1", 70, "standard_deviation.along"},
      {"/standard_deviation/v/1", 3, "standard_deviation.v"},
      {"/standard_deviation", 3, "standard_deviation"},
  };
  for (const Case& c : cases) {
    json bad = good;
    bad[json::json_pointer(c.pointer)] = c.value;
    const auto read = parse_surface_json(bad.dump(), "bad.json");
    ASSERT_FALSE(read) << c.pointer;
    EXPECT_NE(read.error().find(c.says), std::string::npos) << read.error();
    EXPECT_EQ(read.error().rfind("bad.json: ", 0), 0u) << read.error();
  }
  json missing = good;
  missing["base"].erase("z_start_mm");
  EXPECT_NE(parse_surface_json(missing.dump(), "f").error().find("base.z_start_mm is missing"), std::string::npos);
  // Files without standard deviations are whole.
  json older = good;
  older.erase("standard_deviation");
  const auto read = parse_surface_json(older.dump(), "f");
  ASSERT_TRUE(read) << read.error();
  EXPECT_FALSE(read->pieces.front().deviation);
  EXPECT_FALSE(parse_surface_json("", "f"));
  EXPECT_FALSE(parse_surface_json("{\"version\": 1e999}", "f"));
  EXPECT_FALSE(parse_surface_json(std::string(100'000, '['), "f"));
  EXPECT_FALSE(read_surface_json("/absent/surface.json"));
}

RC_GTEST_PROP(SurfaceJson, DoublesAreExact, ()) {
  const auto bits = *rc::gen::arbitrary<std::uint64_t>();
  const auto x = std::bit_cast<double>(bits);
  RC_PRE(std::isfinite(x));
  SurfaceFile file = sample_file();
  file.pieces.front().surface.control_points(0, 0) = x;
  const auto back = parse_surface_json(format_surface_json(file), "f");
  RC_ASSERT(back.has_value());
  RC_ASSERT(std::bit_cast<std::uint64_t>(back->pieces.front().surface.control_points(0, 0)) == bits);
}

RC_GTEST_PROP(SurfaceJson, GarbledTextIsASentenceNotACrash, ()) {
  std::string text = format_surface_json(sample_file());
  for (int k = *rc::gen::inRange(1, 6); k > 0; --k) {
    text[*rc::gen::inRange<std::size_t>(0, text.size())] = static_cast<char>(*rc::gen::inRange(32, 127));
  }
  if (*rc::gen::arbitrary<bool>()) text.resize(*rc::gen::inRange<std::size_t>(0, text.size()));
  const auto read = parse_surface_json(text, "f");
  if (!read.has_value()) RC_ASSERT(read.error().starts_with("f: "));
}

TEST(Report, HasExactlyTheDocumentedFields) {
  ResultNotes notes;
  notes.name = "vase";
  notes.simulated = true;
  notes.warnings = {"second"};
  notes.seconds = {{"prepare", 1}, {"scan", 2}};
  notes.truth_mm = TruthError{-0.001, 0.002, 0.01};
  notes.scan = ScanCounters{"sweep", 1200, 1230, 1, 2, 3, 4};
  notes.closure_mm = ClosureError{0.001, 0.02, 5000};
  notes.solid = CadResult{1234.5, true, 3};
  notes.checks = {{"turn", "deg/turn", {}, {}, {}, CheckVerdict::not_verifiable, "round", {}, {}}};
  notes.calibration = StatedCalibration{"2026-01-01", 0.005, 1e-4};
  notes.dimensions = {{"diameter", "mm", 61, 0.005, 0.003, 0.004}};
  const json j = json::parse(format_report(report_json(sample_fit(), notes)));
  std::set<std::string> names;
  for (const auto& [key, value] : j.items()) names.insert(key);
  EXPECT_EQ(names,
            (std::set<std::string>{
                "format", "version",     "units",        "name",     "date",       "machine",        "simulated",
                "points", "rejected",    "unfollowable", "model",    "degree",     "control_points", "noise_mm",
                "kappa",  "residual_mm", "geometric_mm", "coverage", "decided_by", "stopped_by",     "base",
                "frame",  "band_mm",     "cut_mm",       "size_mm",  "warnings",   "seconds",        "truth_mm",
                "scan",   "closure_mm",  "solid",        "sd_mm",    "checks",     "calibration",    "dimensions"}));
  // RESULTS.md names every one of them.
  const std::string document = read_file(std::filesystem::path(CELADON_SOURCE_DIR) / "daemon/RESULTS.md");
  for (const std::string& name : names) EXPECT_NE(document.find("`" + name + "`"), std::string::npos) << name;
  EXPECT_EQ(j["simulated"], true);
  EXPECT_EQ(j["degree"], json({1, 3}));
  EXPECT_EQ(j["residual_mm"], json({{"rms", 0.02}, {"p95", 0.04}, {"max", 0.1}}));
  EXPECT_EQ(j["frame"]["origin"], json({0.0, 0.0, 0.0}));
  EXPECT_EQ(j["frame"]["z"], json({0.0, 0.0, 1.0}));
  EXPECT_EQ(j["sd_mm"], json({{"mean", 0.001}, {"max", 0.004}}));
  EXPECT_EQ(j["warnings"], json({"first", "second"}));
  EXPECT_EQ(j["seconds"]["scan"], 2.0);
  EXPECT_EQ(j["truth_mm"]["bias"], -0.001);
  EXPECT_EQ(j["checks"][0]["verdict"], "not verifiable");
  EXPECT_EQ(j["calibration"], json({{"date", "2026-01-01"}, {"systematic_mm", 0.005}, {"scale_u", 1e-4}}));
  EXPECT_EQ(j["dimensions"],
            json::parse(R"([{"name": "diameter", "unit": "mm", "value": 61.0, "standard_uncertainty": 0.005,
                                              "of_scatter": 0.003, "of_calibration": 0.004}])"));
  EXPECT_NEAR(j["size_mm"][2].get<double>(), 60, 1e-9);
  EXPECT_NEAR(j["size_mm"][0].get<double>(), 61, 1);
  const json plain = json::parse(format_report(report_json(sample_fit(), {})));
  for (const char* name : {"truth_mm", "scan", "closure_mm", "solid", "checks", "calibration", "dimensions"})
    EXPECT_FALSE(plain.contains(name));
}

TEST(Results, FormatsFollowFromNames) {
  EXPECT_EQ(result_format_of("a/cup.step"), ResultFormat::step);
  EXPECT_EQ(result_format_of("cup.stp"), ResultFormat::step);
  EXPECT_EQ(result_format_of("cup.stl"), ResultFormat::stl);
  EXPECT_EQ(result_format_of("surface.json"), ResultFormat::surface_json);
  EXPECT_EQ(result_format_of("cup.report.json"), ResultFormat::report_json);
  EXPECT_EQ(result_format_of("report.json"), ResultFormat::report_json);
  EXPECT_FALSE(result_format_of("cup.dwg"));
  for (const char* name : {"step", "stl", "ply", "surface.json", "errors.svg", "report.json"}) {
    ASSERT_TRUE(result_format_from(name)) << name;
    EXPECT_STREQ(to_string(*result_format_from(name)), name);
  }
}

auto write_all(const RangeFit& fit, const std::vector<ResultFormat>& formats, const std::filesystem::path& folder,
               ResultNotes& notes) {
  const FittedSurface piece{fit.function, fit.surface};
  return write_results(
      std::span(&piece, 1), [&] { return BodyFit{fit}; }, formats, folder, notes);
}

TEST(Results, TheFolderHoldsWhatWasAskedForAndTheReport) {
  const TemporaryFolder folder;
  ResultNotes notes;
  notes.name = "vase";
  const auto names = write_all(sample_fit(), {ResultFormat::ply, ResultFormat::stl}, folder / "results", notes);
  ASSERT_TRUE(names) << names.error().message;
  EXPECT_EQ(*names, (std::vector<std::string>{"vase.stl", "vase.ply", "errors.svg", "report.json"}));
  std::set<std::string> found;
  for (const auto& entry : std::filesystem::directory_iterator(folder / "results")) {
    found.insert(entry.path().filename());
  }
  EXPECT_EQ(found, (std::set<std::string>{"vase.stl", "vase.ply", "errors.svg", "report.json"}));
  EXPECT_EQ(read_file(folder / "results/vase.ply").substr(0, 3), "ply");
  EXPECT_FALSE(std::filesystem::exists(folder / "results.part"));
  const auto again = write_all(sample_fit(), {}, folder / "results", notes);
  ASSERT_FALSE(again);
  EXPECT_EQ(again.error().exit_code, 2);
}

// The errors are asked for after the STEP file and before the report; without them there is no folder.
TEST(Results, ErrorsThatCannotBeMeasuredLeaveNothing) {
  const TemporaryFolder folder;
  ResultNotes notes;
  const RangeFit fit = sample_fit();
  bool mesh_was_there = false;
  const FittedSurface piece{fit.function, fit.surface};
  const auto names = write_results(
      std::span(&piece, 1),
      [&]() -> tl::expected<BodyFit, ResultError> {
        mesh_was_there = std::filesystem::exists(folder / "results.part/object.stl");
        return tl::make_unexpected(ResultError{4, "the log cannot be read"});
      },
      {ResultFormat::stl}, folder / "results", notes);
  ASSERT_FALSE(names);
  EXPECT_TRUE(mesh_was_there);
  EXPECT_EQ(names.error().message, "the log cannot be read");
  EXPECT_FALSE(std::filesystem::exists(folder / "results"));
  EXPECT_FALSE(std::filesystem::exists(folder / "results.part"));
}

TEST(Results, AFullDiskLeavesNothingUnderTheFinalName) {
  const TemporaryFolder folder;
  const pid_t child = fork();
  ASSERT_GE(child, 0);
  if (child == 0) {
    std::signal(SIGXFSZ, SIG_IGN);
    const rlimit limit{10'000, 10'000};
    setrlimit(RLIMIT_FSIZE, &limit);
    ResultNotes notes;
    const auto names =
        write_all(sample_fit(), {ResultFormat::surface_json, ResultFormat::stl}, folder / "results", notes);
    _exit(!names && names.error().exit_code == 4 && names.error().message.find("object.stl") != std::string::npos ? 0
                                                                                                                  : 1);
  }
  int status = 0;
  waitpid(child, &status, 0);
  EXPECT_EQ(WEXITSTATUS(status), 0);
  EXPECT_TRUE(std::filesystem::is_empty(folder.path()));
}

// A daemon killed at any moment: the folder is not there, or it is whole. The child is killed after a growing number of
// its own file operations, counted by where it stops to be told.
TEST(Results, AKilledWriterLeavesTheFolderWholeOrAbsent) {
  int absent = 0, whole = 0;
  for (int delay_us = 0; delay_us < 40'000 && (absent < 8 || whole < 3); delay_us += 500) {
    const TemporaryFolder folder;
    int ready[2];
    ASSERT_EQ(pipe(ready), 0);
    const pid_t child = fork();
    ASSERT_GE(child, 0);
    if (child == 0) {
      ResultNotes notes;
      const RangeFit fit = sample_fit();
      [[maybe_unused]] const auto told = write(ready[1], "x", 1);
      (void)write_all(fit, {ResultFormat::surface_json, ResultFormat::stl, ResultFormat::ply}, folder / "results",
                      notes);
      _exit(0);
    }
    char byte = 0;
    ASSERT_EQ(read(ready[0], &byte, 1), 1);
    usleep(static_cast<useconds_t>(delay_us));  // no deadline: any moment will do
    kill(child, SIGKILL);
    waitpid(child, nullptr, 0);
    close(ready[0]);
    close(ready[1]);
    if (!std::filesystem::exists(folder / "results")) {
      ++absent;
      continue;
    }
    ++whole;
    for (const char* name : {"surface.json", "object.stl", "object.ply", "errors.svg", "report.json"}) {
      ASSERT_TRUE(std::filesystem::exists(folder / "results" / name)) << name;
    }
    EXPECT_TRUE(read_surface_json(folder / "results/surface.json"));
    EXPECT_FALSE(json::parse(read_file(folder / "results/report.json"), nullptr, false).is_discarded());
  }
  EXPECT_GT(absent, 0);
}

}  // namespace
}  // namespace celadon
