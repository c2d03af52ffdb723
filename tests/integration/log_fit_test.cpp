// `celadon fit` on the logs of scans: whole ones, and what a killed daemon leaves.

#include <gtest/gtest.h>

#include <csignal>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>

#include "tests/integration/process.h"
#include "tests/integration/station.h"

namespace celadon::testing {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

std::string log_in(const fs::path& store) {
  for (const auto& entry : fs::recursive_directory_iterator(store))
    if (entry.path().filename() == "profiles.log") return entry.path();
  return {};
}

TEST(LogFit, GivesTheSurfaceOfItsScanAgain) {
  Station station("vase");
  station.start_daemon();
  const auto scan = run({"celadon", "scan", "--server", station.server(), "--name", "my vase", "--profiles", "200",
                         "-o", station.folder / "out"});
  ASSERT_EQ(scan.exit_code, 0) << scan.err;
  const json first = json::parse(read_file(station.folder / "out" / "report.json"));
  const std::string log = log_in(station.folder / "store");
  ASSERT_FALSE(log.empty());
  const std::string step = station.folder / "again.step", report = station.folder / "again.report.json";
  const auto fit = run({"celadon", "fit", log, "-o", step, "--report", report});
  ASSERT_EQ(fit.exit_code, 0) << fit.err;
  const json again = json::parse(read_file(report));
  EXPECT_EQ(again["name"], first["name"]);
  EXPECT_EQ(again["date"], first["date"]);
  EXPECT_EQ(again["simulated"], true);
  EXPECT_EQ(again["model"], first["model"]);
  EXPECT_EQ(again["points"], first["points"]);
  EXPECT_NEAR(again["size_mm"][2].get<double>(), first["size_mm"][2].get<double>(), 0.5);
  EXPECT_NEAR(again["geometric_mm"]["rms"].get<double>(), first["geometric_mm"]["rms"].get<double>(), 0.002);
  EXPECT_EQ(run({"celadon", "fit", log, "--unit", "cm", "-o", step}).exit_code, 2);

  // A power cut in the middle of a record: what is whole is fitted, and it is said.
  const std::string all = read_file(log);
  const std::string torn = station.folder.write("torn.log", all.substr(0, all.size() * 6 / 7));
  const auto part = run({"celadon", "fit", torn, "--angles", "auto", "-o", step, "--report", report});
  ASSERT_EQ(part.exit_code, 0) << part.err;
  EXPECT_NE(part.out.find("The scan was interrupted: its log has no end"), std::string::npos) << part.out;
  // A byte that changed is no tail: refused by offset.
  std::string damaged = all;
  damaged[all.size() / 2] ^= 1;
  const auto refused = run({"celadon", "fit", station.folder.write("damaged.log", damaged), "-o", step});
  EXPECT_EQ(refused.exit_code, 2);
  EXPECT_NE(refused.err.find("offset"), std::string::npos) << refused.err;
}

TEST(LogFit, AnotherShapeNeedsNoOtherScan) {
  Station station("stepped-shaft");
  station.start_daemon();
  const auto scan = run({"celadon", "scan", "--server", station.server(), "--profiles", "200", "--formats", "stl", "-o",
                         station.folder / "out"});
  ASSERT_EQ(scan.exit_code, 0) << scan.err;
  const std::string report = station.folder / "again.report.json";
  const auto fit = run({"celadon", "fit", log_in(station.folder / "store"), "--shape", "auto", "-o",
                        station.folder / "again.step", "--report", report});
  ASSERT_EQ(fit.exit_code, 0) << fit.err;
  EXPECT_EQ(json::parse(read_file(report))["shoulders"].size(), 5u) << fit.out;
}

}  // namespace
}  // namespace celadon::testing
