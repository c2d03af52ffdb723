#include "acquisition/calibration.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <bit>
#include <filesystem>
#include <fstream>
#include <random>

#include "tests/acquisition/test_calibration.h"

namespace celadon {
namespace {

using testing::AllOf;
using testing::HasSubstr;

std::uint64_t bits(double value) {
  return std::bit_cast<std::uint64_t>(value);
}

/// Every number of a calibration, in one order, as bits.
std::vector<std::uint64_t> all_bits(const Calibration& c) {
  std::vector<std::uint64_t> out;
  const auto add = [&](double v) { out.push_back(bits(v)); };
  const auto add_measured = [&](const Measured& m) {
    add(m.value);
    add(m.u);
  };
  const CameraModel& camera = c.camera_model;
  add(camera.width_px);
  add(camera.height_px);
  for (const Measured* m : {&camera.fx_px, &camera.fy_px, &camera.cx_px, &camera.cy_px}) add_measured(*m);
  for (const Measured& m : camera.distortion) add_measured(m);
  for (const LaserPlane& plane : c.lasers) {
    add(plane.laser);
    for (const double v : plane.normal_C) add(v);
    add(plane.distance_mm);
    add(plane.u_normal_rad);
    add(plane.u_distance_mm);
  }
  for (const double v : c.axis.X_CW.linear().reshaped()) add(v);
  for (const double v : c.axis.X_CW.translation()) add(v);
  add(c.axis.u_direction_rad);
  add(c.axis.u_position_mm);
  add_measured(c.encoder.scale);
  add_measured(c.encoder.cos_rad);
  add_measured(c.encoder.sin_rad);
  add(c.encoder.direction);
  add_measured(c.scale);
  add(c.systematic_mm);
  add(c.u_drift_mm);
  if (c.elevation) {
    for (const double v : c.elevation->origin_mm) add(v);
    for (const double v : c.elevation->direction) add(v);
    add(c.elevation->u_direction_rad);
    add(c.elevation->u_origin_mm);
    add_measured(c.elevation->scale);
  }
  if (c.lift) {
    for (const double v : c.lift->direction) add(v);
    add(c.lift->u_direction_rad);
    add_measured(c.lift->scale);
  }
  if (c.covariance) {
    for (const double v : c.covariance->matrix.reshaped()) add(v);
  }
  for (const Measured* m : {&c.time.stamp_offset_ns, &c.time.exposure_factor, &c.time.line_time_ns}) add_measured(*m);
  return out;
}

std::string with(const std::string& from, const std::string& to) {
  std::string text = format_calibration(test_calibration());
  const std::size_t at = text.find(from);
  EXPECT_NE(at, std::string::npos) << from;
  return text.replace(at, from.size(), to);
}

std::string refusal(const std::string& text) {
  const auto parsed = parse_calibration(text, "calibration file.toml");
  EXPECT_FALSE(parsed) << text;
  return parsed ? "" : parsed.error().message;
}

RC_GTEST_PROP(Calibration, formatting_and_parsing_changes_no_bit, ()) {
  std::mt19937_64 random(*rc::gen::arbitrary<std::uint64_t>());
  std::uniform_real_distribution<double> uniform(-1, 1);
  // Numbers of every size, with all their digits.
  const auto any = [&] { return uniform(random) * std::exp2(std::uniform_int_distribution<int>(-1060, 300)(random)); };
  const auto u = [&] { return std::abs(any()); };
  const auto near = [&](double value, double by) { return Measured{value + by * uniform(random), u()}; };
  Calibration c;
  c.machine = "m" + *rc::gen::container<std::string>(rc::gen::inRange<char>(1, 127));
  c.camera = "c" + *rc::gen::container<std::string>(rc::gen::inRange<char>(1, 127)) + "\"\\ \u00e9\u4e2d";
  c.date = "2024-02-29";
  c.simulated = uniform(random) < 0;
  c.camera_model.width_px = std::uniform_int_distribution<int>(64, 4000)(random);
  c.camera_model.height_px = std::uniform_int_distribution<int>(64, 4000)(random);
  const double focal = 1.5 * std::max(c.camera_model.width_px, c.camera_model.height_px);
  c.camera_model.fx_px = near(focal, 0.1 * focal);
  c.camera_model.fy_px = near(focal, 0.1 * focal);
  c.camera_model.cx_px = near(0.5 * c.camera_model.width_px, 10);
  c.camera_model.cy_px = near(0.5 * c.camera_model.height_px, 10);
  for (Measured& k : c.camera_model.distortion) k = near(0, 0.01);
  for (int i = 0; i < *rc::gen::inRange(1, 5); ++i) {
    LaserPlane plane;
    plane.laser = 255 - i;
    plane.normal_C = Eigen::Vector3d(uniform(random), uniform(random), uniform(random) + 2).normalized();
    plane.distance_mm = 100 + 50 * uniform(random);
    plane.u_normal_rad = u();
    plane.u_distance_mm = u();
    c.lasers.push_back(plane);
  }
  c.axis.X_CW.linear() = Eigen::Quaterniond(uniform(random), uniform(random), uniform(random), uniform(random) + 2)
                             .normalized()
                             .toRotationMatrix();
  c.axis.X_CW.translation() = Eigen::Vector3d(any(), any(), -0.0);
  c.axis.u_direction_rad = u();
  c.axis.u_position_mm = u();
  c.encoder.scale = near(1, 0.1);
  c.encoder.direction = uniform(random) < 0 ? -1 : 1;
  if (uniform(random) < 0) {
    c.encoder.cos_rad = near(0, 0.1);
    c.encoder.sin_rad = near(0, 0.1);
  }
  c.scale = near(1, 0.1);
  c.systematic_mm = u();
  c.time = {{any(), u()}, {any(), u()}, {any(), u()}};
  if (uniform(random) < 0) c.u_drift_mm = u();
  if (uniform(random) < 0) {
    const Eigen::Vector3d direction(1.5 + uniform(random), uniform(random), 0.3 * uniform(random));
    c.elevation = ElevationAxis{{any(), any(), any()}, direction.normalized(), u(), u(), near(1, 0.1)};
  }
  if (uniform(random) < 0) {
    const Eigen::Vector3d direction(uniform(random), uniform(random), 2);
    c.lift = LiftAxis{direction.normalized(), u(), near(1, 0.1)};
  }
  if (uniform(random) < 0) {
    const std::vector<std::string> names = {"laser255.offset_mm", "fx_px", "k3", "axis.tilt_y_rad",
                                            "platter.height_mm"};
    const auto size = static_cast<Eigen::Index>(names.size());
    const Eigen::MatrixXd root = Eigen::MatrixXd::NullaryExpr(size, 2, [&] { return uniform(random) + 1e-3; });
    const Eigen::MatrixXd matrix = root * root.transpose();  // of rank 2: as near to the border as can be
    c.covariance = CalibrationCovariance{names, 0.5 * (matrix + matrix.transpose())};
  }

  const auto parsed = parse_calibration(format_calibration(c), "generated");
  RC_ASSERT(parsed.has_value());
  RC_ASSERT(all_bits(*parsed) == all_bits(c));
  RC_ASSERT(parsed->machine == c.machine);
  RC_ASSERT(parsed->camera == c.camera);
  RC_ASSERT(parsed->date == c.date);
  RC_ASSERT(parsed->simulated == c.simulated);
  RC_ASSERT(parsed->elevation.has_value() == c.elevation.has_value());
  RC_ASSERT(parsed->lift.has_value() == c.lift.has_value());
  RC_ASSERT(parsed->covariance.has_value() == c.covariance.has_value());
  if (c.covariance) RC_ASSERT(parsed->covariance->names == c.covariance->names);
}

/// The text of a calibration with a covariance, in which something was replaced.
std::string with_covariance(const std::string& from, const std::string& to) {
  Calibration c = test_calibration();
  Eigen::Matrix2d matrix;
  matrix << 4, -1, -1, 0.5;
  c.covariance = CalibrationCovariance{{"axis.x_mm", "laser1.offset_mm"}, matrix};
  std::string text = format_calibration(c);
  const std::size_t at = text.find(from);
  EXPECT_NE(at, std::string::npos) << from << text;
  return text.replace(at, from.size(), to);
}

TEST(Calibration, a_covariance_that_cannot_be_is_refused) {
  EXPECT_TRUE(parse_calibration(with_covariance("names", "names"), "f"));
  EXPECT_THAT(refusal(with_covariance("\"axis.x_mm\"", "\"axis.z_mm\"")), HasSubstr("no number of this calibration"));
  EXPECT_THAT(refusal(with_covariance("laser1.offset", "laser7.offset")), HasSubstr("no number of this calibration"));
  EXPECT_THAT(refusal(with_covariance("laser1.offset_mm", "axis.x_mm")), HasSubstr("stands twice"));
  EXPECT_THAT(refusal(with_covariance("[\"axis.x_mm\", ", "[")), HasSubstr("array of 1 rows"));
  EXPECT_THAT(refusal(with_covariance("[4.0]", "[4.0, 1.0]")), HasSubstr("array of 1 numbers"));
  EXPECT_THAT(refusal(with_covariance("[4.0]", "[-4.0]")), HasSubstr("no covariance"));
  EXPECT_THAT(refusal(with_covariance("[4.0]", "[1.0]")), HasSubstr("no covariance"));  // -1 is beyond sqrt(0.5)
  EXPECT_THAT(refusal(with_covariance("[4.0]", "[nan]")), HasSubstr("finite"));
}

// Files of before the covariance, and of before elevation and lift.
TEST(Calibration, older_minor_versions_are_read) {
  for (const char* version : {"1.0", "1.1"}) {
    const auto parsed = parse_calibration(with("version = \"1.3\"", "version = \"" + std::string(version) + "\""), "f");
    ASSERT_TRUE(parsed) << parsed.error().message;
    EXPECT_FALSE(parsed->elevation || parsed->lift);
  }
}

/// The text of a calibration with both further axes, in which something was replaced.
std::string with_axes(const std::string& from, const std::string& to) {
  Calibration c = test_calibration();
  c.elevation = ElevationAxis{{0.25, -0.5, 41}, {0.6, 0.8, 0}, 1e-4, 0.02, {0.999, 3e-4}};
  c.lift = LiftAxis{{0.6, 0, 0.8}, 2e-4, {1.0021, 5e-5}};
  std::string text = format_calibration(c);
  const std::size_t at = text.find(from);
  EXPECT_NE(at, std::string::npos) << from << text;
  return text.replace(at, from.size(), to);
}

TEST(Calibration, axes_that_cannot_be_are_refused) {
  const auto parsed = parse_calibration(with_axes("[lift]", "[lift]"), "f");
  ASSERT_TRUE(parsed) << parsed.error().message;
  EXPECT_EQ(parsed->elevation->scale, (Measured{0.999, 3e-4}));
  EXPECT_EQ(parsed->lift->direction, Eigen::Vector3d(0.6, 0, 0.8));
  EXPECT_THAT(refusal(with_axes("direction = [0.6, 0.8, 0.0]", "direction = [0.6, 0.8, 0.1]")),
              AllOf(HasSubstr("elevation.direction: has length 1.00"), HasSubstr("divide it")));
  EXPECT_THAT(refusal(with_axes("direction = [0.6, 0.8, 0.0]", "direction = [0.6, 0.0, 0.8]")),
              AllOf(HasSubstr("elevation.direction: has z = 0.8"), HasSubstr("45 degrees"), HasSubstr("again")));
  EXPECT_THAT(refusal(with_axes("direction = [0.6, 0.0, 0.8]", "direction = [0.8, 0.0, 0.6]")),
              AllOf(HasSubstr("lift.direction: has z = 0.6"), HasSubstr("45 degrees"), HasSubstr("again")));
  EXPECT_THAT(refusal(with_axes("direction = [0.6, 0.0, 0.8]", "direction = [0.6, 0.0, -0.8]")), HasSubstr("z = -0.8"));
  EXPECT_THAT(refusal(with_axes("scale = { value = 0.999", "scale = { value = -0.999")),
              AllOf(HasSubstr("elevation.scale.value"), HasSubstr("above 0")));
  EXPECT_THAT(refusal(with_axes("scale = { value = 1.0021", "scale = { value = 0.0")), HasSubstr("lift.scale.value"));
  EXPECT_THAT(refusal(with_axes("u_origin_mm = 0.02", "u_origin_mm = -0.02")),
              AllOf(HasSubstr("elevation.u_origin_mm"), HasSubstr("negative")));
  EXPECT_THAT(refusal(with_axes("u_origin_mm = 0.02\n", "")), AllOf(HasSubstr("u_origin_mm"), HasSubstr("missing")));
  EXPECT_THAT(refusal(with_axes("[lift]\n", "[lift]\ntravel_mm = 3\n")), HasSubstr("not a key"));
}

TEST(Calibration, a_covariance_may_name_the_numbers_of_the_axes_that_are_there) {
  Calibration c = test_calibration();
  c.elevation = ElevationAxis{};
  c.covariance = CalibrationCovariance{{"elevation.up_mm", "elevation.scale"}, Eigen::Matrix2d::Identity()};
  const auto parsed = parse_calibration(format_calibration(c), "f");
  ASSERT_TRUE(parsed) << parsed.error().message;
  EXPECT_EQ(parsed->covariance->names, c.covariance->names);
  c.covariance->names[1] = "lift.scale";
  EXPECT_THAT(refusal(format_calibration(c)), HasSubstr("no number of this calibration"));
}

TEST(Calibration, the_crossing_is_the_point_of_the_rotary_axis_nearest_to_the_elevation_axis) {
  // A line along x that passes the rotary axis at y = 3 and z = 50.
  const AxisCrossing level = crossing_of({{-7, 3, 50}, {1, 0, 0}, 0, 0, {1, 0}});
  EXPECT_NEAR(level.z_mm, 50, 1e-12);
  EXPECT_NEAR(level.gap_mm, 3, 1e-12);
  // One that rises in the plane y = -2 and is at z = 60 where x = 0.
  const AxisCrossing rising = crossing_of({{4, -2, 63}, {0.8, 0, 0.6}, 0, 0, {1, 0}});
  EXPECT_NEAR(rising.z_mm, 60, 1e-12);
  EXPECT_NEAR(rising.gap_mm, 2, 1e-12);
}

TEST(Calibration, the_head_turns_right_handed_about_the_line) {
  // About the line along x through (0, 0, 50), a quarter turn takes (5, 0, 80) to (5, -30, 50).
  const ElevationAxis axis{{0, 0, 50}, {1, 0, 0}, 0, 0, {2, 0}};
  const Eigen::Vector3d p = head_turn(axis, std::acos(0.) / 2) * Eigen::Vector3d(5, 0, 80);
  EXPECT_LT((p - Eigen::Vector3d(5, -30, 50)).norm(), 1e-12);
}

// Written by escapes, so that the parser never meets them.
TEST(Calibration, characters_beyond_ascii_are_written_as_escapes_and_refused_as_bytes) {
  Calibration c = test_calibration();
  c.camera = "caf\u00e9 \u4e2d \U0001F4F7 \xff";
  const std::string text = format_calibration(c);
  EXPECT_TRUE(std::all_of(text.begin(), text.end(), [](char byte) { return static_cast<unsigned char>(byte) < 0x80; }));
  EXPECT_THAT(text, HasSubstr("caf\\u00E9 \\u4E2D \\U0001F4F7 \\uFFFD"));
  const auto parsed = parse_calibration(text, "f");
  ASSERT_TRUE(parsed) << parsed.error().message;
  EXPECT_EQ(parsed->camera, "caf\u00e9 \u4e2d \U0001F4F7 \uFFFD");
  EXPECT_THAT(refusal(with("camera = \"", "camera = \"\xC3\xA9")),
              AllOf(HasSubstr("line 5, column"), HasSubstr("0xC3")));
}

TEST(Calibration, whole_numbers_and_comments_of_people_are_read) {
  const auto parsed =
      parse_calibration(with("cx_px = { value = 650.5, u = 0.8 }", "cx_px = { value = 650, u = 1 } # so"), "f");
  ASSERT_TRUE(parsed) << parsed.error().message;
  EXPECT_EQ(parsed->camera_model.cx_px, (Measured{650, 1}));
}

TEST(Calibration, an_error_names_file_line_field_value_and_remedy) {
  EXPECT_THAT(refusal(with("fx_px = { value = 1402.25", "fx_px = { value = -1402.25")),
              AllOf(HasSubstr("calibration file.toml, line 12, camera_model.fx_px.value"), HasSubstr("-1402.25"),
                    HasSubstr("above 0")));
}

struct Nonsense {
  const char* from;
  const char* to;
  const char* field;
  const char* why;
};

class CalibrationNonsense : public testing::TestWithParam<Nonsense> {};

TEST_P(CalibrationNonsense, is_refused_by_name) {
  const Nonsense& n = GetParam();
  EXPECT_THAT(refusal(with(n.from, n.to)), AllOf(HasSubstr(n.field), HasSubstr(n.why), HasSubstr("line ")));
}

INSTANTIATE_TEST_SUITE_P(
    All, CalibrationNonsense,
    testing::Values(
        Nonsense{"value = 1402.25", "value = nan", "camera_model.fx_px.value", "must be finite"},
        Nonsense{"value = 1402.25", "value = inf", "camera_model.fx_px.value", "must be finite"},
        Nonsense{"value = 1402.25", "value = 1e999", "", "is not TOML"},
        Nonsense{"value = 1402.25", "value = \"1402.25\"", "camera_model.fx_px.value", "must be a number"},
        Nonsense{"value = 1402.25, u = 0.5", "value = 1402.25, u = -0.5", "camera_model.fx_px.u", "cannot be negative"},
        Nonsense{"value = 1402.25, u = 0.5", "value = 1402.25", "camera_model.fx_px.u", "is missing"},
        Nonsense{"fx_px = {", "fx_pix = {", "camera_model.fx_px", "is missing"},
        Nonsense{"cx_px = { value = 650.5", "cx_px = { value = 65050.0", "camera_model.cx_px.value",
                 "outside the image"},
        Nonsense{"width_px = 1280", "width_px = 0", "camera_model.width_px", "from 1 to 65535"},
        Nonsense{"width_px = 1280", "width_px = 99999999999999999999", "", "is not TOML"},
        Nonsense{"height_px = 1024", "height_px = 1024.5", "camera_model.height_px", "whole number"},
        Nonsense{"k1 = { value = -0.21", "k1 = { value = -4.0", "camera_model.k1", "folds the image"},
        Nonsense{"distance_mm = ", "distance_mm = 0.0 # ", "laser[0].distance_mm", "measures nothing"},
        Nonsense{"number = 1", "number = 0", "laser[1].number", "number each laser once"},
        Nonsense{"number = 1", "number = 256", "laser[1].number", "from 0 to 255"},
        Nonsense{"normal = [", "normal = [1.0, ", "laser[0].normal", "three numbers"},
        Nonsense{"normal = [", "normal = [1.0, 1.0, 1.0] # ", "laser[0].normal", "length 1"},
        Nonsense{"rotation = [", "rotation = [[1,0,0],[0,1,0],[0,0,-1]] # [", "", "is not TOML"},
        Nonsense{"direction = -1", "direction = 2", "encoder.direction", "must be 1 or -1"},
        Nonsense{"[encoder]\nscale = { value = 1.0002", "[encoder]\nscale = { value = 0.0", "encoder.scale", "above 0"},
        Nonsense{"direction = -1", "direction = -1\ncos_rad = { value = 0.6, u = 0.0 }", "encoder.cos_rad",
                 "within half of the scale"},
        Nonsense{"direction = -1", "direction = -1\nsin_rad = 0.001", "encoder.sin_rad", ""},
        Nonsense{"systematic_mm = 0.015", "systematic_mm = -0.015", "geometry.systematic_mm", "negative"},
        Nonsense{"simulated = false", "simulated = \"no\"", "simulated", "true or false"},
        Nonsense{"machine = \"Celadon test bench 42\"", "machine = \"\"", "machine", "empty"},
        Nonsense{"date = \"2025-03-31T14:05:00Z\"", "date = \"31.3.2025\"", "date", "ISO 8601"},
        Nonsense{"date = \"2025-03-31T14:05:00Z\"", "date = 2025-03-31", "date", "text in quotes"},
        Nonsense{"simulated = false", "simulated = false\nextra = 1", "extra", "not a key"},
        Nonsense{"systematic_mm = 0.015", "systematic_mm = 0.015\nsystemic_mm = 1", "systemic_mm", "not a key"},
        Nonsense{"celadon-calibration\"", "horus-calibration\"", "format", "not a calibration file"},
        Nonsense{"version = \"1.3\"", "version = \"1\"", "version", "MAJOR.MINOR"},
        Nonsense{"version = \"1.3\"", "version = 1.0", "version", "text in quotes"}));

TEST(Calibration, a_matrix_that_is_no_rotation_is_refused) {
  Calibration c = test_calibration();
  c.axis.X_CW.linear()(1, 1) += 1e-6;
  EXPECT_THAT(refusal(format_calibration(c)), AllOf(HasSubstr("axis.rotation"), HasSubstr("differs from a rotation")));
  c = test_calibration();
  c.axis.X_CW.linear().row(0) *= -1;
  EXPECT_THAT(refusal(format_calibration(c)), AllOf(HasSubstr("axis.rotation"), HasSubstr("reflection")));
}

TEST(Calibration, a_calibration_without_lasers_is_refused) {
  Calibration c = test_calibration();
  c.lasers.clear();
  EXPECT_THAT(refusal(format_calibration(c)), AllOf(HasSubstr("laser"), HasSubstr("is missing")));
}

TEST(Calibration, a_newer_minor_version_is_read_and_a_newer_major_one_refused) {
  std::string text = with("version = \"1.3\"", "version = \"1.7\"\ntilt = { travel_rad = 1 }");
  text.replace(text.find("systematic_mm"), 0, "shrinkage = 3\n");
  const auto parsed = parse_calibration(text, "f");
  ASSERT_TRUE(parsed) << parsed.error().message;
  EXPECT_EQ(all_bits(*parsed), all_bits(test_calibration()));
  EXPECT_THAT(refusal(with("version = \"1.3\"", "version = \"2.0\"")),
              AllOf(HasSubstr("\"2.0\""), HasSubstr("update Celadon")));
  EXPECT_THAT(refusal(with("version = \"1.3\"", "version = \"0.9\"")), HasSubstr("calibrate again"));
}

TEST(Calibration, a_check_names_both_values) {
  const Calibration c = test_calibration();
  EXPECT_TRUE(check_calibration(c, c.machine, c.camera, 1280, 1024));
  EXPECT_THAT(check_calibration(c, "other machine", c.camera, 1280, 1024).error().message,
              AllOf(HasSubstr("other machine"), HasSubstr(c.machine)));
  EXPECT_THAT(check_calibration(c, c.machine, "other camera", 1280, 1024).error().message,
              AllOf(HasSubstr("other camera"), HasSubstr(c.camera)));
  EXPECT_THAT(check_calibration(c, c.machine, c.camera, 640, 480).error().message,
              AllOf(HasSubstr("1280 x 1024"), HasSubstr("640 x 480")));
}

TEST(Calibration, files_that_cannot_be_read_are_named) {
  const auto folder = std::filesystem::path(testing::TempDir()) / "calibration_files";
  std::filesystem::create_directories(folder);
  const auto message = [&](const std::string& name) { return read_calibration(folder / name).error().message; };
  EXPECT_THAT(message("absent.toml"), AllOf(HasSubstr("absent.toml"), HasSubstr("errno 2")));
  EXPECT_THAT(message("."), HasSubstr("is a folder"));
  std::ofstream(folder / "empty.toml") << "";
  EXPECT_THAT(message("empty.toml"), HasSubstr("is empty"));
  std::ofstream(folder / "long.toml") << std::string(3 << 20, '#');
  EXPECT_THAT(message("long.toml"), HasSubstr("1 MiB"));
  std::ofstream(folder / "good.toml") << format_calibration(test_calibration());
  const auto good = read_calibration(folder / "good.toml");
  ASSERT_TRUE(good) << good.error().message;
  EXPECT_EQ(all_bits(*good), all_bits(test_calibration()));
  std::filesystem::remove_all(folder);
}

TEST(Calibration, a_truncated_file_is_refused_at_every_length) {
  const std::string text = format_calibration(test_calibration());
  const std::size_t last_value = text.rfind("u = 10");
  for (std::size_t size = 0; size < last_value; size += 7) {
    const auto parsed = parse_calibration(text.substr(0, size), "cut");
    ASSERT_FALSE(parsed) << size;
    ASSERT_FALSE(parsed.error().message.empty());
  }
}

TEST(Calibration, damaged_and_hostile_texts_are_refused_or_read_as_sane_values) {
  const std::string text = format_calibration(test_calibration());
  std::mt19937 random(7);
  for (int trial = 0; trial < 1500; ++trial) {
    std::string damaged = text;
    for (int k = 0; k < 1 + trial % 4; ++k) damaged[random() % damaged.size()] = static_cast<char>(random());
    if (const auto parsed = parse_calibration(damaged, "damaged")) {
      EXPECT_GT(parsed->camera_model.fx_px.value, 0);
      EXPECT_TRUE(parsed->axis.X_CW.matrix().allFinite());
    }
  }
  EXPECT_THAT(refusal("a = " + std::string(100'000, '[')), HasSubstr("not TOML"));
  EXPECT_THAT(refusal(std::string("format\0 = 1", 11)), HasSubstr("not TOML"));
  for (const char* key : {"[!]", "[ =]", "[[,]]", "a = {!=1}", "a = {,}"})
    EXPECT_THAT(refusal(key), HasSubstr("not TOML"));
  EXPECT_THAT(refusal("laser = 1\nformat = \"celadon-calibration\"\nversion = \"1.0\""), HasSubstr("machine"));
}

}  // namespace
}  // namespace celadon
