// celadon accept on the virtual scanner, whose artefact is known exactly.

#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "tests/integration/station.h"

namespace celadon::testing {
namespace {

using nlohmann::json;

constexpr const char* kPermissible = "form95=0.2,size=0.1,spacing=0.1,flatness95=0.2";

std::string with(std::string text, const std::string& what, const std::string& by) {
  const auto at = text.find(what);
  EXPECT_NE(at, std::string::npos) << what;
  return at == std::string::npos ? text : text.replace(at, what.size(), by);
}

void write(const std::string& file, const std::string& text) {
  std::ofstream(file) << text;
}

json item_of(const json& report, const std::string& what, const std::string& where) {
  for (const json& item : report["items"]) {
    if (item["characteristic"] == what && item["where"] == where) return item;
  }
  ADD_FAILURE() << what << " of " << where << " is not in " << report.dump(2);
  return {};
}

// A picture of half the size: a scan of a known artefact, its certificate made wrong, and its scale.
TEST(AcceptCommand, AKnownArtefactConformsAndWrongCertificatesAndScalesAreNamed) {
  Station station("artefact", {"--width", "640", "--height", "512"});
  const std::string certificate = run({"celadon-sim", "truth", "--artefact"}).out;
  write(station.folder / "artefact.toml", certificate);
  station.start_daemon();
  const auto good = run({"celadon", "accept", "--artefact", station.folder / "artefact.toml", "--mpe", kPermissible,
                         "--server", station.server(), "--profiles", "360", "-o", station.folder / "out"});
  ASSERT_EQ(good.exit_code, 0) << good.out << good.err;
  EXPECT_NE(good.out.find("verdict     conforms"), std::string::npos) << good.out;
  EXPECT_NE(good.out.find("not a certificate"), std::string::npos) << good.out;
  const json report = json::parse(read_file(station.folder / "out" / "acceptance.json"));
  EXPECT_EQ(report["simulated"], true);
  EXPECT_EQ(report["items"].size(), 14u);
  EXPECT_EQ(item_of(report, "form", "A")["verdict"], "not judged");
  EXPECT_LT(std::abs(item_of(report, "spacing", "A-B")["error_mm"].get<double>()), 0.03);
  // The scan itself says that its samples are all there is.
  const json scan = json::parse(read_file(station.folder / "out" / "report.json"));
  EXPECT_EQ(scan["base"], "none");
  EXPECT_GT(scan["points"], 20'000);
  EXPECT_NE(scan["warnings"].dump().find("No surface was fitted"), std::string::npos);

  const auto judge = [&](const std::string& text, const std::string& log) {
    write(station.folder / "other.toml", text);
    return run({"celadon", "accept", "--artefact", station.folder / "other.toml", "--mpe", kPermissible, "--log", log,
                "-o", station.folder / "again"});
  };
  const auto wrong = judge(with(certificate, "value = 30.0071", "value = 30.2071"), station.folder / "out");
  EXPECT_EQ(wrong.exit_code, 1) << wrong.err;
  EXPECT_NE(wrong.out.find("ball B stands apart"), std::string::npos) << wrong.out;
  EXPECT_EQ(item_of(json::parse(read_file(station.folder / "again" / "acceptance.json")), "size", "B")["verdict"],
            "does not conform");
  // The same samples, from the daemon's store.
  EXPECT_EQ(judge(certificate, station.folder / "store/scans/000001/profiles.log").exit_code, 0);

  // A calibration that takes all lengths for 0.3 % longer.
  station.daemon->signal(SIGTERM);
  station.daemon->wait();
  const std::string calibration = read_file(station.folder / "calibration.toml");
  write(station.folder / "calibration.toml",
        with(calibration, "[geometry]\nscale = { value = 1.0,", "[geometry]\nscale = { value = 1.003,"));
  station.start_daemon();
  const auto scaled = run({"celadon", "accept", "--artefact", station.folder / "artefact.toml", "--mpe", kPermissible,
                           "--server", station.server(), "--profiles", "360", "-o", station.folder / "scaled"});
  EXPECT_EQ(scaled.exit_code, 1) << scaled.err;
  EXPECT_NE(scaled.out.find("calibration's scale is wrong"), std::string::npos) << scaled.out;
  EXPECT_NE(scaled.out.find("too long"), std::string::npos) << scaled.out;
}

TEST(AcceptCommand, WrongInputIsNamed) {
  const TemporaryFolder folder;
  EXPECT_EQ(run({"celadon", "accept"}).exit_code, 2);
  write(folder / "bad.toml", "format = \"celadon-artefact\"\nversion = \"1.0\"\nname = \"x\"\nsphere = 1\n");
  const auto bad = run({"celadon", "accept", "--artefact", folder / "bad.toml"});
  EXPECT_EQ(bad.exit_code, 2);
  EXPECT_NE(bad.err.find("line 4"), std::string::npos) << bad.err;
  const auto limit = run({"celadon", "accept", "--simulate", "--mpe", "length=1"});
  EXPECT_EQ(limit.exit_code, 2);
  EXPECT_NE(limit.err.find("length=1"), std::string::npos) << limit.err;
  write(folder / "good.toml", run({"celadon-sim", "truth", "--artefact"}).out);
  const auto missing = run(
      {"celadon", "accept", "--artefact", folder / "good.toml", "--log", folder / "none.log", "-o", folder / "out"});
  EXPECT_EQ(missing.exit_code, 2);
  EXPECT_NE(missing.err.find("none.log"), std::string::npos) << missing.err;
  EXPECT_EQ(run({"celadon", "accept", "--artefact", folder / "good.toml", "--server", "http://127.0.0.1:1", "-o",
                 folder / "out"})
                .exit_code,
            3);
  EXPECT_EQ(run({"celadon", "accept", "--help"}).exit_code, 0);
}

}  // namespace
}  // namespace celadon::testing
