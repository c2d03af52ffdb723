// Elevation axis and lift of the virtual scanner, calibrated from its pictures and compared with its truth; a scan from
// several stops with that calibration; and where head and lift are left when a calibration ends before its end.
#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <string>
#include <vector>

#include "acquisition/calibrate/calibration_solver.h"
#include "acquisition/calibration_change.h"
#include "tests/acquisition/stop_truth.h"
#include "tests/integration/board_operator.h"
#include "tests/integration/process.h"
#include "tests/integration/station.h"

namespace celadon::testing {
namespace {

using Eigen::Vector3d;

const std::vector<std::string> kLeaningBack = {"@0,0,58,0,-28,30", "@10,-6,58,0,-22,150"};

/// Rendering is what these tests wait for: a small picture, and a board whose tags are found in it.
constexpr const char* kLargeBoard = "tags:10x7x10";
const std::vector<std::string> kSmallCamera = {"--ambient", "8",        "--fps", "12",          "--width",
                                               "960",       "--height", "768",   "--elevation", "--lift"};

/// Where a point of the object comes out at a stop, less where it comes out with all at 0, for a camera that sees both
/// as the truth has them: 0 if the calibration is true.
Vector3d split(const Calibration& calibration, const Calibration& truth, const AxisStop& stop) {
  const Vector3d p_W(25, 15, 60);
  return camera_to_object(calibration, stop) * seen_at_stop(truth, p_W, 0, stop) -
         camera_to_object(calibration, {}) * seen_at_stop(truth, p_W, 0, {});
}

/// The truth's axes in the frame of a calibration: that turned onto the true rotary axis by the smallest turn, origin
/// on the true platter (CALIBRATION.md, what the names of the covariance mean).
struct TrueAxes {
  ElevationAxis elevation;
  LiftAxis lift;
};
TrueAxes in_frame_of(const Calibration& calibration, const Calibration& truth) {
  const Eigen::Isometry3d to_solved = calibration.axis.X_CW.inverse() * truth.axis.X_CW;
  const Eigen::Matrix3d onto =
      Eigen::Quaterniond::FromTwoVectors(Vector3d::UnitZ(), to_solved.linear().col(2)).matrix();
  const Eigen::Matrix3d R = onto.transpose() * to_solved.linear();
  TrueAxes out{*truth.elevation, *truth.lift};
  out.elevation.direction = R * truth.elevation->direction;
  out.elevation.origin_mm = R * truth.elevation->origin_mm;
  out.lift.direction = R * truth.lift->direction;
  return out;
}

void expect_within(const char* what, double error, double u, double largest_u) {
  std::printf("%-22s error %9.2e, u %8.2e\n", what, error, u);
  EXPECT_LE(std::abs(error), 3 * u) << what;
  EXPECT_GT(u, 0) << what;
  EXPECT_LT(u, largest_u) << what;
}

void expect_true_axes(const Calibration& calibration, const Calibration& truth) {
  ASSERT_TRUE(calibration.elevation && calibration.lift && truth.elevation && truth.lift);
  const auto& [elevation, lift] = in_frame_of(calibration, truth);
  const ElevationAxis& e = *calibration.elevation;
  const Vector3d u = (Vector3d::UnitZ() - e.direction * e.direction.z()).normalized(), v = e.direction.cross(u);
  const Vector3d to_line = elevation.origin_mm - e.origin_mm;
  const Vector3d apart =
      to_line - elevation.direction * (e.direction.dot(to_line) / e.direction.dot(elevation.direction));
  expect_within("elevation, tilt up", u.dot(elevation.direction), e.u_direction_rad, 1e-3);
  expect_within("elevation, tilt across", v.dot(elevation.direction), e.u_direction_rad, 1e-3);
  expect_within("elevation, up", u.dot(apart), e.u_origin_mm, 0.1);
  expect_within("elevation, across", v.dot(apart), e.u_origin_mm, 0.1);
  expect_within("elevation, reading", e.scale.value - elevation.scale.value, e.scale.u, 5e-4);
  const LiftAxis& l = *calibration.lift;
  expect_within("lift, towards x", lift.direction.x() - l.direction.x(), l.u_direction_rad, 1e-3);
  expect_within("lift, towards y", lift.direction.y() - l.direction.y(), l.u_direction_rad, 1e-3);
  expect_within("lift, reading", l.scale.value - lift.scale.value, l.scale.u, 5e-4);
}

/// What two stops see of one place, against what the joint covariance says of it.
void expect_stops_that_meet(const Calibration& calibration, const Calibration& truth) {
  for (const AxisStop& stop : {AxisStop{0.7, 0}, AxisStop{0, -25}, AxisStop{0.5, 20}}) {
    const CalibrationCovariance& joint = *calibration.covariance;
    Eigen::Matrix<double, 3, Eigen::Dynamic> J(3, joint.matrix.rows());
    for (Eigen::Index i = 0; i < J.cols(); ++i) {
      const std::string& name = joint.names[static_cast<std::size_t>(i)];
      const double step = std::sqrt(joint.matrix(i, i));
      J.col(i) = (split(changed(calibration, name, step), truth, stop) -
                  split(changed(calibration, name, -step), truth, stop)) /
                 (2 * step);
    }
    const Vector3d apart = split(calibration, truth, stop);
    const Vector3d u = (J * joint.matrix * J.transpose()).diagonal().cwiseSqrt();
    for (int i = 0; i < 3; ++i) expect_within("two stops, mm", apart[i], u[i], 0.1);
  }
}

TEST(CalibratingAxes, HeadAndLiftAreThoseOfTheTruthAndStopsOfAScanAgree) {
  Station station("empty", kSmallCamera);
  auto machine = open_scanner(station.url, station.camera);
  ASSERT_TRUE(machine) << machine.error().message;
  const CalibrationPlan plan{*TargetBoard::parse(kLargeBoard), 7, 2, 16, 4, {1, 1e-4}, {1, 1e-4}, 4, 0};
  BoardOperator hand(station, kLargeBoard, kLeaningBack, 10);
  const auto input = take_calibration_views(*machine, plan, hand);
  ASSERT_TRUE(input) << input.error().reason;
  EXPECT_GE(hand.seen_at_stops, 12) << "of 16";
  const auto stands = station.state();
  EXPECT_NEAR(stands["elevation"]["angle_rad"].get<double>(), 0, 1e-4);
  EXPECT_NEAR(stands["lift"]["height_mm"].get<double>(), 0, 0.02);
  const auto solved = solve_calibration(*input);
  ASSERT_TRUE(solved) << solved.error();
  print_steps(*solved);
  EXPECT_NE(solved->verdict, Verdict::refused);
  const auto truth = read_calibration(station.folder / "calibration.toml");
  ASSERT_TRUE(truth);
  expect_true_axes(solved->calibration, *truth);
  expect_stops_that_meet(solved->calibration, *truth);

  const Calibration calibration = for_scans(solved->calibration, *machine);
  machine->device.reset();
  machine = tl::make_unexpected(ConnectError{});  // the machine is the daemon's now
  station.folder.write("calibration.toml", format_calibration(calibration));
  ask_simulator(station.folder.path(), "scene sphere");
  station.start_daemon();
  const auto scanned = run({"celadon", "scan", "--server", station.server(), "--shape", "sphere", "--profiles", "100",
                            "--elevations", "0,40", "--lifts", "0,-15", "-o", station.folder / "out"});
  ASSERT_EQ(scanned.exit_code, 0) << scanned.out << scanned.err;
  const auto report = nlohmann::json::parse(read_file(station.folder / "out" / "report.json"));
  std::printf("%s\n", report["truth_mm"].dump().c_str());
  EXPECT_LT(report["truth_mm"]["rms"].get<double>(), 3 * calibration.systematic_mm);
  bool compared = false;
  for (const auto& check : report["checks"]) {
    if (check["name"] != "stop_agreement") continue;
    std::printf("%s\n", check.dump().c_str());
    EXPECT_EQ(check["verdict"], "passed") << check;
    compared = true;
  }
  EXPECT_TRUE(compared) << scanned.out;
}

/// Ends a calibration while the head is raised.
class Ending : public BoardOperator {
 public:
  enum class By { guide, button };
  Ending(const Station& station, By by)
      : BoardOperator(station, kLargeBoard, kLeaningBack), station_(station), by_(by) {}

  void on_stop(int placement, const AxisStop& stop, bool found) override {
    BoardOperator::on_stop(placement, stop, found);
    if (ended || stop.elevation_rad < 0.2) return;
    ended = true;
    if (by_ == By::button) ask_simulator(station_.folder.path(), "press");
  }
  std::optional<std::string> cancelled() override {
    return ended && by_ == By::guide ? std::optional<std::string>("by the test") : std::nullopt;
  }
  bool ended = false;

 private:
  const Station& station_;
  By by_;
};

/// Where head and lift are after a calibration that was ended so.
nlohmann::json left_by(Ending::By by) {
  const Station station("empty", kSmallCamera);
  auto machine = open_scanner(station.url, station.camera);
  EXPECT_TRUE(machine) << machine.error().message;
  const CalibrationPlan plan{*TargetBoard::parse(kLargeBoard), 0, 1, 16, 4, {1, 1e-4}, {1, 1e-4}, 3, 0};
  Ending hand(station, by);
  const auto input = take_calibration_views(*machine, plan, hand);
  EXPECT_FALSE(input);
  EXPECT_TRUE(hand.ended) << "it ended before the head was raised";
  if (!input) std::printf("%s\n", input.error().reason.c_str());
  expect_safe(station);
  return station.state();
}

TEST(CalibratingAxes, CancelledTheyAreBroughtBack) {
  const auto state = left_by(Ending::By::guide);
  EXPECT_NEAR(state["elevation"]["angle_rad"].get<double>(), 0, 1e-4);
  EXPECT_NEAR(state["lift"]["height_mm"].get<double>(), 0, 0.02);
}

TEST(CalibratingAxes, AfterAPressOfTheButtonNothingMoves) {
  const auto state = left_by(Ending::By::button);
  EXPECT_GT(state["elevation"]["angle_rad"].get<double>(), 0.1);
}

}  // namespace
}  // namespace celadon::testing
