// Partial sums as a user calls them: three machines reduce, one merges. Frames, spheres, resumption, refusals.

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <functional>
#include <nlohmann/json.hpp>
#include <numbers>
#include <random>
#include <string>
#include <vector>

#include "tests/integration/process.h"
#include "tests/temporary_folder.h"

namespace celadon::testing {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

// Lines x y z of a body in a frame, all of them and in three parts.
struct Clouds {
  std::string all, part[3];
};
Clouds clouds_of(const std::function<Eigen::Vector3d(double t, double h)>& body, int count,
                 const Eigen::Isometry3d& X) {
  std::mt19937 random(7);
  std::uniform_real_distribution<double> share(0, 1);
  Clouds clouds;
  for (int k = 0; k < count; ++k) {
    const Eigen::Vector3d p = X * body(2 * std::numbers::pi * share(random), share(random));
    char line[128];
    std::snprintf(line, sizeof line, "%.17g %.17g %.17g\n", p.x(), p.y(), p.z());
    clouds.all += line;
    clouds.part[k % 3] += line;
  }
  return clouds;
}

std::function<Eigen::Vector3d(double, double)> lobed_vase() {
  return [random = std::mt19937(3), normal = std::normal_distribution<double>()](double t, double h) mutable {
    const double r = 30 + 5 * std::sin(5 * h) + 2 * std::cos(3 * t) + 0.02 * normal(random);
    return Eigen::Vector3d(r * std::cos(t), r * std::sin(t), 80 * h);
  };
}

std::function<Eigen::Vector3d(double, double)> egg() {
  return [](double t, double h) {
    const double c = 2 * h - 1, s = std::sqrt(1 - c * c), r = 25 + 2 * c + s * s * std::cos(2 * t);
    return Eigen::Vector3d(r * s * std::cos(t), r * s * std::sin(t), 40 + r * c);
  };
}

// Coefficients of two surface files: the largest difference.
double difference(const fs::path& a, const fs::path& b) {
  const json x = json::parse(read_file(a))["range_function"], y = json::parse(read_file(b))["range_function"];
  if (x["knots_u"] != y["knots_u"] || x["knots_v"] != y["knots_v"]) return 1e300;
  double worst = 0;
  for (std::size_t i = 0; i < x["coefficients"].size(); ++i)
    for (std::size_t j = 0; j < x["coefficients"][i].size(); ++j)
      worst = std::max(worst, std::abs(x["coefficients"][i][j].get<double>() - y["coefficients"][i][j].get<double>()));
  return worst;
}

class Merge : public ::testing::Test {
 protected:
  void reduce(const Clouds& clouds, std::vector<std::string> grid_options) {
    std::vector<std::string> command = {"celadon", "fit", folder.write("all.xyz", clouds.all), "--write-grid",
                                        folder / "grid.json"};
    command.insert(command.end(), grid_options.begin(), grid_options.end());
    const auto made = run(command);
    ASSERT_EQ(made.exit_code, 0) << made.err;
    for (int k = 0; k < 3; ++k) {
      const std::string name = std::to_string(k);
      const auto outcome = run({"celadon", "fit", "--partial", "--grid", folder / "grid.json",
                                folder.write(name + ".xyz", clouds.part[k]), "-o", part(k)});
      ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
    }
  }
  std::string part(int k) { return folder / (std::to_string(k) + ".part"); }
  TemporaryFolder folder;
};

TEST_F(Merge, IsTheFitOfAllToRoundingAndTheSameBytesInAnyOrder) {
  reduce(clouds_of(lobed_vase(), 60000, Eigen::Isometry3d::Identity()), {"--axis", "z"});
  for (const auto& [name, order] : {std::pair("a", std::vector<int>{0, 1, 2}), {"b", {2, 0, 1}}}) {
    const auto outcome = run({"celadon", "merge", part(order[0]), part(order[1]), part(order[2]), "-o",
                              folder / (std::string(name) + ".json"), folder / (std::string(name) + ".step"),
                              "--report", folder / "r.json"});
    ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  }
  for (const char* end : {".json", ".step"})
    EXPECT_EQ(read_file(folder / (std::string("a") + end)), read_file(folder / (std::string("b") + end))) << end;
  const auto one =
      run({"celadon", "fit", "--grid", folder / "grid.json", folder / "all.xyz", "-o", folder / "one.json"});
  ASSERT_EQ(one.exit_code, 0) << one.err;
  EXPECT_LT(difference(folder / "a.json", folder / "one.json"), 1e-10);
  const json report = json::parse(read_file(folder / "r.json"));
  EXPECT_EQ(report["points"], 60000);
  EXPECT_NE(report["stopped_by"].get<std::string>().find("from the sums of 3 inputs"), std::string::npos);
  EXPECT_TRUE(report["solid"]["valid"].get<bool>());
}

// Two of three, later all: sums of sums are a part again.
TEST_F(Merge, GoesOnWhereItStopped) {
  reduce(clouds_of(lobed_vase(), 20000, Eigen::Isometry3d::Identity()), {"--axis", "z"});
  const auto two = run({"celadon", "merge", part(0), part(1), "-o", folder / "two.part"});
  ASSERT_EQ(two.exit_code, 0) << two.err;
  const auto later = run({"celadon", "merge", folder / "two.part", part(2), "-o", folder / "later.json"});
  ASSERT_EQ(later.exit_code, 0) << later.err;
  ASSERT_EQ(run({"celadon", "merge", part(0), part(1), part(2), "-o", folder / "at-once.json"}).exit_code, 0);
  EXPECT_LT(difference(folder / "later.json", folder / "at-once.json"), 1e-10);
  // The same samples by two ways are told from the names of their inputs.
  const auto twice = run({"celadon", "merge", folder / "two.part", part(1)});
  EXPECT_EQ(twice.exit_code, 0) << twice.err;
  EXPECT_NE(twice.out.find("'1.xyz'"), std::string::npos) << twice.out;
}

// A leaning part, and a sphere off the origin: the grid's frame is that of the inputs.
TEST_F(Merge, KeepsFrameAndBase) {
  Eigen::Isometry3d X = Eigen::Isometry3d::Identity();
  X.linear() = Eigen::AngleAxisd(0.9, Eigen::Vector3d(3, -2, 1).normalized()).toRotationMatrix();
  X.translation() << 15, -8, 40;
  const auto vase = [](double t, double h) {
    const double z = 80 * h, r = 30 + 0.2 * z - 0.006 * z * z + 4e-5 * z * z * z;
    return Eigen::Vector3d(r * std::cos(t), r * std::sin(t), z);
  };
  reduce(clouds_of(vase, 20000, X), {});
  ASSERT_EQ(run({"celadon", "merge", part(0), part(1), part(2), "-o", folder / "m.json"}).exit_code, 0);
  ASSERT_EQ(run({"celadon", "fit", folder / "all.xyz", "-o", folder / "one.json"}).exit_code, 0);
  const json merged = json::parse(read_file(folder / "m.json")), one = json::parse(read_file(folder / "one.json"));
  EXPECT_EQ(merged["base"]["frame"], one["base"]["frame"]);
  EXPECT_LT(difference(folder / "m.json", folder / "one.json"), 1e-9);

  reduce(clouds_of(egg(), 20000, Eigen::Isometry3d::Identity()), {"--axis", "z", "--shape", "sphere"});
  const auto outcome = run({"celadon", "merge", part(0), part(1), part(2), "-o", folder / "m.json"});
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  ASSERT_EQ(run({"celadon", "fit", folder / "all.xyz", "--axis", "z", "--shape", "sphere", "-o", folder / "one.json"})
                .exit_code,
            0);
  EXPECT_LT(difference(folder / "m.json", folder / "one.json"), 1e-9);
}

TEST_F(Merge, RefusesInOneSentence) {
  reduce(clouds_of(lobed_vase(), 6000, Eigen::Isometry3d::Identity()), {"--axis", "z"});
  json other = json::parse(read_file(folder / "grid.json"));
  other["millimetres_per_unit"] = 10;
  other["band"] = {0, 800};
  folder.write("cm.json", other.dump());
  ASSERT_EQ(
      run({"celadon", "fit", "--partial", "--grid", folder / "cm.json", folder / "0.xyz", "-o", folder / "cm.part"})
          .exit_code,
      0);
  const std::string bytes = read_file(part(1));
  folder.write("torn.part", bytes.substr(0, bytes.size() / 2));
  struct Case {
    std::vector<std::string> command;
    std::vector<std::string> says;
  };
  const std::string grid = folder / "grid.json", cloud = folder / "0.xyz", out = folder / "x.part";
  const Case cases[] = {
      {{"celadon", "merge", part(0), folder / "cm.part"}, {"0.part", "cm.part", "band", "800"}},
      {{"celadon", "merge", part(0), folder / "torn.part"}, {"torn.part", "truncated"}},
      {{"celadon", "merge", part(0), cloud}, {"0.xyz", "no part"}},
      {{"celadon", "merge", part(0), part(0)}, {"same part"}},
      {{"celadon", "merge", part(0), folder / "none.part"}, {"none.part"}},
      {{"celadon", "merge", part(0), "-o", folder / "no" / "folder.step"}, {"no folder"}},
      {{"celadon", "merge"}, {"PART"}},
      {{"celadon", "fit", "--partial", cloud, "-o", out}, {"--grid"}},
      {{"celadon", "fit", "--partial", "--grid", grid, cloud}, {"-o FILE.part"}},
      {{"celadon", "fit", "--partial", "--grid", grid, cloud, "--unit", "in", "-o", out}, {"25.4", "1 mm"}},
      {{"celadon", "fit", "--partial", "--grid", grid, cloud, "--axis", "x", "-o", out}, {"--axis", "--grid"}},
      {{"celadon", "fit", "--partial", "--grid", cloud, cloud, "-o", out}, {"0.xyz", "JSON"}},
      {{"celadon", "fit", cloud, "--shape", "composite", "--split-above", "40", "--write-grid", out}, {"composite"}}};
  for (const Case& c : cases) {
    const auto outcome = run(c.command);
    EXPECT_EQ(outcome.exit_code, 2) << outcome.out << outcome.err;
    for (const std::string& text : c.says) EXPECT_NE(outcome.err.find(text), std::string::npos) << outcome.err;
    EXPECT_EQ(std::count(outcome.err.begin(), outcome.err.end(), '\n'), 1) << outcome.err;
    EXPECT_FALSE(fs::exists(out));
  }
  // A disk that fills leaves nothing under the final name.
  const auto full = run({"celadon", "fit", "--partial", "--grid", grid, cloud, "-o", out}, 2000);
  EXPECT_EQ(full.exit_code, 4) << full.err;
  EXPECT_FALSE(fs::exists(out));
}

}  // namespace
}  // namespace celadon::testing
