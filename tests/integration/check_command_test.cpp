// celadon check on the virtual scanner: objects that are known exactly.

#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "tests/integration/process.h"

namespace celadon::testing {
namespace {

using nlohmann::json;

TEST(CheckCommand, AKnownCylinderIsGoodAndAWrongCertificateIsRefused) {
  const TemporaryFolder folder;
  const auto good = run({"celadon", "check", "--reference", "cylinder:D=60,u=0.002", "--simulate", "cylinder",
                         "--profiles", "400", "-o", folder / "out"});
  ASSERT_EQ(good.exit_code, 0) << good.out << good.err;
  const json file = json::parse(read_file(folder / "out" / "check.json"));
  EXPECT_EQ(file["verdict"], "good") << file.dump(2);
  EXPECT_EQ(file["simulated"], true);
  EXPECT_NEAR(file["measured"]["diameter_mm"].get<double>(), 60, 0.025);  // README of sim: 5 um of radius, optics
  EXPECT_LT(file["normalised_error"].get<double>(), 1);
  EXPECT_NE(good.out.find("verdict     good"), std::string::npos) << good.out;

  // The same scan against a certificate of another object, and of the same one in U and with a temperature.
  const auto judge = [&](const std::string& reference) {
    return run({"celadon", "check", "--reference", reference, "--result", folder / "out", "-o", folder / "again"});
  };
  const auto refused = judge("cylinder:D=60.2,u=0.002");
  EXPECT_EQ(refused.exit_code, 1) << refused.err;
  EXPECT_NE(refused.out.find("verdict     refused"), std::string::npos) << refused.out;
  EXPECT_EQ(json::parse(read_file(folder / "again" / "check.json"))["verdict"], "refused");
  // 59.9 mm of aluminium become 60 at 92.6 degrees.
  EXPECT_EQ(judge("cylinder:D=59.9,U=0.004,a=2.3e-5,T=92.6").exit_code, 0);
  EXPECT_EQ(judge("sphere:D=60,u=0.002").exit_code, 2);
}

TEST(CheckCommand, BesideTheAxisAndAsASphere) {
  const TemporaryFolder folder;
  const std::pair<const char*, const char*> objects[] = {{"cylinder-off", "cylinder:D=50,u=0.002"},
                                                         {"sphere", "sphere:D=70,u=0.002"}};
  for (const auto& [scene, reference] : objects) {
    const auto outcome = run(
        {"celadon", "check", "--reference", reference, "--simulate", scene, "--profiles", "400", "-o", folder / scene});
    EXPECT_EQ(outcome.exit_code, 0) << outcome.out << outcome.err;
    const json file = json::parse(read_file(folder / scene / "check.json"), nullptr, false);
    ASSERT_TRUE(file.is_object());
    EXPECT_EQ(file["verdict"], "good") << file.dump(2);
  }
}

TEST(CheckCommand, WrongInputIsNamed) {
  const TemporaryFolder folder;
  const std::string result = folder / "nothing";
  EXPECT_EQ(run({"celadon", "check"}).exit_code, 2);
  const auto wrong = run({"celadon", "check", "--reference", "cone:D=3,u=1", "--result", result});
  EXPECT_EQ(wrong.exit_code, 2);
  EXPECT_NE(wrong.err.find("cone:D=3"), std::string::npos) << wrong.err;
  const auto missing = run({"celadon", "check", "--reference", "cylinder:D=60,u=0.002", "--result", result});
  EXPECT_EQ(missing.exit_code, 2);
  EXPECT_NE(missing.err.find("report.json"), std::string::npos) << missing.err;
  EXPECT_EQ(run({"celadon", "check", "--reference", "cylinder:D=60,u=0.002", "--result", result, "--simulate", "vase"})
                .exit_code,
            2);
  EXPECT_EQ(run({"celadon", "check", "--reference", "cylinder:D=60,u=0.002", "--server", "http://127.0.0.1:1", "-o",
                 folder / "out"})
                .exit_code,
            3);
  EXPECT_EQ(run({"celadon", "check", "--help"}).exit_code, 0);
}

}  // namespace
}  // namespace celadon::testing
