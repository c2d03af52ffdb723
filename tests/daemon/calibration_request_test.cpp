// Requests for calibrations: what is wrong is named, what is right comes back; and how a calibration file is replaced.

#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>

#include <nlohmann/json.hpp>

#include "daemon/calibration/calibration_file.h"
#include "daemon/calibration/calibration_record.h"
#include "tests/temporary_folder.h"

namespace celadon {
namespace {

using nlohmann::json;
using testing::read_file;
using testing::TemporaryFolder;

TEST(CalibrationRequestJson, EveryFieldComesBack) {
  const json whole = {{"board", "chessboard:11x8x8"},
                      {"width_mm", 88.1},
                      {"height_mm", 63.9},
                      {"measured_u_mm", 0.05},
                      {"views", 15},
                      {"placements", 2},
                      {"angles", 24},
                      {"stops", 0},
                      {"exposure_ms", 4.5}};
  const auto request = calibration_request_from_json(whole);
  ASSERT_TRUE(request) << request.error().detail;
  EXPECT_EQ(to_json(*request), whole);
  const auto plain = calibration_request_from_json(json::object());
  ASSERT_TRUE(plain);
  EXPECT_EQ(plain->board, "tags:10x7x12");
  EXPECT_FALSE(plain->width_mm);
  EXPECT_FALSE(to_json(*plain).contains("width_mm"));
}

TEST(CalibrationRequestJson, NamesWhatIsWrong) {
  struct Case {
    const char* body;
    const char* says;
  };
  const Case cases[] = {
      {R"([])", "JSON object"},
      {R"({"width": 120})", "'width' is not a field"},
      {R"({"board": 7})", "board is 7; give a board"},
      {R"({"board": "circles:3x4x5"})", "board \"circles:3x4x5\" is neither"},
      {R"({"board": "tags:10x7xnan"})", "board \"tags:10x7xnan\""},
      {R"({"board": "tags:99x7x12"})", "3 to 60 columns"},
      {R"({"width_mm": 0})", "width_mm is 0; give a number from 1 to 10000 mm"},
      {R"({"width_mm": -120})", "width_mm is -120"},
      {R"({"width_mm": "NaN"})", "width_mm is \"NaN\""},
      {R"({"height_mm": true})", "height_mm is true"},
      {R"({"width_mm": 100})", "width_mm is 100, but tags:10x7x12 should be 120 x 84 mm; measure over all squares"},
      {R"({"width_mm": 120, "height_mm": 100})", "height_mm is 100, but"},
      {R"({"measured_u_mm": 0})", "measured_u_mm is 0; give a number from 0.0001 to 10 mm"},
      {R"({"views": 4})", "views is 4; give a whole number from 5 to 200"},
      {R"({"placements": 0})", "placements is 0"},
      {R"({"angles": 7})", "angles is 7"},
      {R"({"stops": 101})", "stops is 101"},
      {R"({"stops": 18446744073709551615})", "stops is 18446744073709551615"},
      {R"({"exposure_ms": -1})", "exposure_ms is -1"},
  };
  for (const Case& c : cases) {
    const auto request = calibration_request_from_json(json::parse(c.body));
    ASSERT_FALSE(request) << c.body;
    EXPECT_EQ(request.error().status, 422);
    EXPECT_NE(request.error().detail.find(c.says), std::string::npos) << request.error().detail;
  }
  const auto huge = calibration_request_from_json(json{{"board", std::string(60'000, 'x')}});
  ASSERT_FALSE(huge);
  EXPECT_LT(huge.error().detail.size(), 300u);
}

TEST(CalibrationRequestJson, AConfirmationNamesItsStepOrNone) {
  EXPECT_EQ(**confirmed_step_from_json(json{{"step", 2}}), 2);
  EXPECT_FALSE(confirmed_step_from_json(json::object())->has_value());
  EXPECT_NE(confirmed_step_from_json(json{{"steps", 2}}).error().detail.find("'steps'"), std::string::npos);
  EXPECT_NE(confirmed_step_from_json(json{{"step", 0}}).error().detail.find("step is 0"), std::string::npos);
  EXPECT_FALSE(confirmed_step_from_json(json::array()));
}

TEST(CalibrationRecordJson, ComesBackWithWhatIsNoNumber) {
  CalibrationRecord record;
  record.step = 3;
  record.verdict = "refused";
  record.steps = {{"laser 0", "refused", "It was never seen.", "Switch it on."}};
  record.values = CalibrationValues{0.02, 0.03, 0.04, std::nan(""), 12, 1};
  CalibrationRecord again;
  read_calibration_findings(json::parse(to_json(record).dump()), again);
  EXPECT_EQ(to_json(again).dump(), to_json(record).dump());
}

TEST(CalibrationFile, KeepsEveryOneBeforeIt) {
  const TemporaryFolder folder;
  const auto file = folder / "scanner.toml";
  EXPECT_EQ(*replace_calibration(file, "first", ""), "");
  EXPECT_EQ(*replace_calibration(file, "second", "2026-01-31T12:00:00Z"), folder / "scanner-2026-01-31T12-00-00Z.toml");
  EXPECT_EQ(*replace_calibration(file, "third", "2026-01-31T12:00:00Z"),
            folder / "scanner-2026-01-31T12-00-00Z-2.toml");
  EXPECT_EQ(read_file(file), "third");
  EXPECT_EQ(read_file(folder / "scanner-2026-01-31T12-00-00Z.toml"), "first");
  EXPECT_EQ(read_file(folder / "scanner-2026-01-31T12-00-00Z-2.toml"), "second");
  // A date that was written by hand leads nowhere else.
  EXPECT_EQ(*replace_calibration(file, "fourth", "../../x"), folder / "scanner-..-..-x.toml");
}

TEST(CalibrationFile, WithoutSpaceForItTheOldOneStays) {
  const TemporaryFolder folder;
  const auto file = folder.write("scanner.toml", "first");
  std::filesystem::create_directory(folder / "scanner-2026.toml");
  const auto kept = replace_calibration(file, "second", "2026");
  // The name is taken by a folder: another one is found, and nothing is lost.
  ASSERT_TRUE(kept) << kept.error().message;
  EXPECT_EQ(*kept, folder / "scanner-2026-2.toml");
  EXPECT_EQ(read_file(*kept), "first");
  const auto nowhere = replace_calibration(folder / "none" / "scanner.toml", "third", "2026");
  ASSERT_FALSE(nowhere);
  EXPECT_NE(nowhere.error().message.find("none/scanner.toml"), std::string::npos) << nowhere.error().message;
}

}  // namespace
}  // namespace celadon
