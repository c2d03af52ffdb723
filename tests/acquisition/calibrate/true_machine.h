#pragma once
// A machine whose every number is known, and what its camera sees of a board: written from CALIBRATION.md's formulas,
// without the code under test.

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <cmath>
#include <functional>
#include <numbers>
#include <optional>
#include <random>
#include <vector>

#include "acquisition/calibrate/calibration_solver.h"

namespace celadon::test {

constexpr double kDegree = std::numbers::pi / 180;

/// What a real machine does beyond the calibrated model; none of it by default.
/// tests/integration/stated_lengths.h has sizes.
struct BeyondModel {
  // The print: out of flatness at its rim, against its middle; and each corner's own error.
  double bow_mm = 0, print_mm = 0;
  // The lens: a ripple over the picture, period 430 px, that no polynomial of the model follows.
  double ripple_px = 0;
  // The sheet: out of its plane by bow_per_mm s^2, s from the axis towards the camera.
  double sheet_bow_per_mm = 0;
  // The spindle: twice a turn, in and across the radius, along and about the axis, and the encoder.
  double radial_mm = 0, axial_mm = 0, wobble_rad = 0, encoder_rad = 0, phase_rad = 0;
  // What extraction adds to all points of one line, and to all corners of one picture.
  double line_bias_px = 0, corner_bias_px = 0;
  // Standard deviation of the camera's turn about its vertical from view to view, and from the last one to a scan.
  double warming_rad = 0;
};

struct TrueMachine {
  BeyondModel beyond;
  double camera_turn_rad = 0;  ///< about its own vertical, at this time
  int width_px = 1280, height_px = 1024;
  std::array<double, 9> camera = {2100, 2102, 645.8, 507.4, -0.12, 0.05, 4e-4, -3e-4, 0.01};
  Eigen::Isometry3d X_CW = Eigen::Isometry3d::Identity();  ///< z the axis upward, origin on the platter
  struct Sheet {
    int laser;
    Eigen::Vector3d normal_W;
    double distance_mm;
  };
  std::vector<Sheet> sheets;
  double encoder_scale = 1.0008, encoder_cos_rad = 0, encoder_sin_rad = 0, direction = 1;
  /// The head turns about a line, the lift moves the table; given in the scanner's frame, as CALIBRATION.md has them.
  struct Elevation {
    Eigen::Vector3d origin_W, direction_W;
    double scale;
  };
  struct Lift {
    Eigen::Vector3d direction_W;
    double scale;
  };
  std::optional<Elevation> elevation;
  std::optional<Lift> lift;
  /// instant(row) = stamp + offset + factor * exposure + row * line, and how far the table lags while it turns
  /// backwards.
  struct Timing {
    double offset_s = 0, exposure_factor = -0.5, line_s = 0, backlash_rad = 0;
  } timing;
  Eigen::Vector2d pitch{1, 1};
  Eigen::Vector2d platter_slope{0, 0};

  /// Camera 300 mm from the axis, 30 degrees beside the laser and 12 above; two lasers, mirrored about the camera.
  TrueMachine() {
    constexpr double kAbove = 12 * kDegree, kBeside = 30 * kDegree;
    const Eigen::Vector3d target(0, 0, 58);
    const Eigen::Vector3d eye = target + 300 * Eigen::Vector3d(std::cos(kAbove) * std::cos(kBeside),
                                                               std::cos(kAbove) * std::sin(kBeside), std::sin(kAbove));
    const Eigen::Vector3d forward = (target - eye).normalized();
    const Eigen::Vector3d right = forward.cross(Eigen::Vector3d::UnitZ()).normalized();
    X_CW.linear() << right.transpose(), forward.cross(right).transpose(), forward.transpose();
    X_CW.translation() = -X_CW.linear() * eye;
    const auto sheet = [](int laser, double azimuth, double offset, double tilt) {
      return Sheet{
          laser, {-std::sin(azimuth) * std::cos(tilt), std::cos(azimuth) * std::cos(tilt), std::sin(tilt)}, offset};
    };
    sheets = {sheet(0, 0, 0.13, 0.004), sheet(1, 2 * kBeside, -0.21, -0.003)};
  }

  /// Across the camera's view through (0, 0, 58) and upward, both but for errors as machines have them.
  void add_head_and_lift() {
    const Eigen::Vector3d along(0.5, -std::cos(30 * kDegree), 0), across(std::cos(30 * kDegree), 0.5, 0);
    elevation = Elevation{{0.31, -0.17, 58.4}, (along + Eigen::Vector3d(0.002, 0.001, -0.0025)).normalized(), 1.0007};
    elevation->origin_W += 0.2 * across;
    lift = Lift{Eigen::Vector3d(0.0015, -0.0011, 1).normalized(), 0.9996};
  }

  Eigen::Vector2d project(const Eigen::Vector3d& cold_C) const {
    const auto& [fx, fy, cx, cy, k1, k2, p1, p2, k3] = camera;
    const double turn = camera_turn_rad;
    const Eigen::Vector3d p_C(cold_C.x() - turn * cold_C.z(), cold_C.y(), cold_C.z() + turn * cold_C.x());
    const double a = p_C.x() / p_C.z(), b = p_C.y() / p_C.z(), s = a * a + b * b;
    const double g = 1 + k1 * s + k2 * s * s + k3 * s * s * s;
    const Eigen::Vector2d p(fx * (a * g + 2 * p1 * a * b + p2 * (s + 2 * a * a)) + cx,
                            fy * (b * g + p1 * (s + 2 * b * b) + 2 * p2 * a * b) + cy);
    if (beyond.ripple_px == 0) return p;
    constexpr double kPerPx = 2 * std::numbers::pi / 430;
    return p + beyond.ripple_px *
                   Eigen::Vector2d(std::sin(kPerPx * (p.x() + 0.4 * p.y())), std::cos(kPerPx * (p.y() - 0.3 * p.x())));
  }
  bool in_picture(const Eigen::Vector2d& p) const {
    return p.x() >= 2 && p.y() >= 2 && p.x() <= width_px - 3 && p.y() <= height_px - 3;
  }
  Eigen::Vector3d normal_C(const Sheet& sheet) const { return X_CW.linear() * sheet.normal_W; }
  double distance_C(const Sheet& sheet) const { return sheet.distance_mm + normal_C(sheet).dot(X_CW.translation()); }
  /// The table's frame in the scanner's.
  Eigen::Isometry3d table_at(double encoder_rad) const {
    const double angle =
        direction * (encoder_scale * encoder_rad + encoder_cos_rad * (std::cos(encoder_rad) - 1) +
                     encoder_sin_rad * std::sin(encoder_rad) + beyond.encoder_rad * std::sin(2 * encoder_rad + 0.8));
    const double twice = 2 * angle + beyond.phase_rad;
    Eigen::Isometry3d motion = Eigen::Isometry3d::Identity();
    motion.translation() << beyond.radial_mm * std::cos(twice), beyond.radial_mm * std::sin(twice + 0.9),
        beyond.axial_mm * std::cos(twice + 2);
    motion.linear() =
        Eigen::AngleAxisd(beyond.wobble_rad * std::cos(twice + 3), Eigen::Vector3d::UnitX()).toRotationMatrix();
    return motion * Eigen::AngleAxisd(angle, Eigen::Vector3d::UnitZ());
  }
  Eigen::Isometry3d turned(double encoder_rad) const { return X_CW * table_at(encoder_rad); }
  /// The same from a stop: p_camera = X_CS R_E(e)^-1 (R_z(theta) p_W + lift.scale h lift.direction).
  Eigen::Isometry3d turned(double encoder_rad, const AxisStop& stop) const {
    Eigen::Isometry3d X = table_at(encoder_rad);
    if (lift) X.pretranslate(lift->scale * stop.lift_mm * lift->direction_W);
    if (elevation) {
      const Eigen::Matrix3d R =
          Eigen::AngleAxisd(elevation->scale * stop.elevation_rad, elevation->direction_W).toRotationMatrix();
      Eigen::Isometry3d head = Eigen::Isometry3d::Identity();
      head.linear() = R;
      head.translation() = elevation->origin_W - R * elevation->origin_W;
      X = head.inverse() * X;
    }
    return X_CW * X;
  }
  /// How far the sheet is out of its plane at a place of the scanner frame, along the plane's normal.
  double sheet_bow_mm(const Eigen::Vector3d& p_W) const {
    return beyond.sheet_bow_per_mm * p_W.head<2>().squaredNorm();
  }
};

struct Noise {
  double corner_px = 0.03, line_px = 0.05;
  bool drawn = true;  ///< false: the standard deviations are stated, nothing is added
};

/// Draws what the camera sees.
class Viewer {
 public:
  Viewer(const TrueMachine& machine, const TargetBoard& board, std::uint64_t seed, Noise noise)
      : machine_(machine), board_(board), random_(seed), noise_(noise), print_seed_(seed) {}

  std::mt19937_64& random() { return random_; }
  double uniform(double lo, double hi) { return std::uniform_real_distribution<double>(lo, hi)(random_); }
  double normal() { return std::normal_distribution<double>()(random_); }

  TrueMachine& machine() { return machine_; }
  Eigen::Vector3d on_board(const Eigen::Isometry3d& X_CB, const Eigen::Vector2d& p_mm) const {
    return X_CB * Eigen::Vector3d(machine_.pitch.x() * p_mm.x(), machine_.pitch.y() * p_mm.y(), bow_mm(p_mm));
  }
  double bow_mm(const Eigen::Vector2d& p_mm) const {
    const double rim = 0.5 * board_.square_mm() * board_.columns();
    return machine_.beyond.bow_mm * p_mm.squaredNorm() / (rim * rim);
  }
  /// Each corner's own error of print, the same in all views.
  Eigen::Vector2d print_error(int id) const {
    if (machine_.beyond.print_mm == 0) return Eigen::Vector2d::Zero();
    std::mt19937_64 of_corner(print_seed_ + 1000003ull * static_cast<std::uint64_t>(id));
    std::normal_distribution<double> error(0, machine_.beyond.print_mm);
    const double x = error(of_corner);
    return {x, error(of_corner)};
  }
  bool whole(const Eigen::Isometry3d& X_CB) const {
    for (const BoardCorner& corner : board_.corners()) {
      const Eigen::Vector3d p = on_board(X_CB, corner.p_mm);
      if (p.z() < 50 || !machine_.in_picture(machine_.project(p))) return false;
    }
    return true;
  }
  std::vector<SeenCorner> corners(const Eigen::Isometry3d& X_CB) {
    std::vector<SeenCorner> out;
    Eigen::Vector2d bias = Eigen::Vector2d::Zero();
    if (machine_.beyond.corner_bias_px > 0) bias = machine_.beyond.corner_bias_px * Eigen::Vector2d(normal(), normal());
    for (const BoardCorner& corner : board_.corners()) {
      const Eigen::Vector2d p = machine_.project(on_board(X_CB, corner.p_mm + print_error(corner.id))) + bias;
      if (!machine_.in_picture(p)) continue;
      out.push_back({corner.id, p + drawn(noise_.corner_px) * Eigen::Vector2d(normal(), normal()), noise_.corner_px});
    }
    return out;
  }
  /// The board on the turning table, each corner at its own row's instant. @param encoder_rad at the frame's stamp
  std::vector<SeenCorner> passing(const Eigen::Isometry3d& X_WB, double encoder_rad, double speed_rad_per_s,
                                  double exposure_s) {
    const TrueMachine::Timing& t = machine_.timing;
    std::vector<SeenCorner> out;
    for (const BoardCorner& corner : board_.corners()) {
      Eigen::Vector2d p(0, 0.5 * machine_.height_px);
      for (int round = 0; round < 8; ++round) {
        const double later_s = t.offset_s + t.exposure_factor * exposure_s + t.line_s * p.y();
        const double lag = speed_rad_per_s < 0 ? t.backlash_rad : 0;
        p = machine_.project(machine_.turned(encoder_rad + speed_rad_per_s * later_s + lag) *
                             on_board(X_WB, corner.p_mm));
      }
      if (!machine_.in_picture(p)) continue;
      out.push_back({corner.id, p + drawn(noise_.corner_px) * Eigen::Vector2d(normal(), normal()), noise_.corner_px});
    }
    return out;
  }
  /// The laser's line on a plane, from `middle` along the line to both sides.
  static double flat(const Eigen::Vector3d&) { return 0; }
  /// `raised_mm` of a place of the plane: how high the surface is over it there.
  SeenLine line(const TrueMachine::Sheet& sheet, const Eigen::Vector3d& plane_normal_C, const Eigen::Vector3d& middle_C,
                double half_length_mm, double step_mm,
                const std::function<double(const Eigen::Vector3d&)>& raised_mm = flat) {
    SeenLine out;
    out.laser = sheet.laser;
    const Eigen::Vector3d n = machine_.normal_C(sheet), along = n.cross(plane_normal_C).normalized();
    // From the middle to the laser plane within the other plane.
    const Eigen::Vector3d across = plane_normal_C.cross(along);
    const Eigen::Vector3d foot = middle_C + across * ((machine_.distance_C(sheet) - n.dot(middle_C)) / n.dot(across));
    const double bias = machine_.beyond.line_bias_px > 0 ? machine_.beyond.line_bias_px * normal() : 0;
    const Eigen::Isometry3d X_WC = machine_.X_CW.inverse();
    for (double s = -half_length_mm; s <= half_length_mm; s += step_mm) {
      const Eigen::Vector3d flat_C = foot + s * along;
      // Where the bowed sheet meets the other plane.
      const Eigen::Vector3d on_plane_C = flat_C + across * (machine_.sheet_bow_mm(X_WC * flat_C) / n.dot(across));
      const Eigen::Vector3d up_sheet = along.cross(n);
      const Eigen::Vector3d p_C = on_plane_C + up_sheet * (raised_mm(on_plane_C) / up_sheet.dot(plane_normal_C));
      const Eigen::Vector2d p = machine_.project(p_C);
      if (!machine_.in_picture(p)) continue;
      const Eigen::Vector2d tangent = (machine_.project(p_C + 1e-3 * along) - p).normalized();
      out.points.push_back(
          {p + (bias + drawn(noise_.line_px) * normal()) * Eigen::Vector2d(-tangent.y(), tangent.x()), noise_.line_px});
    }
    return out;
  }
  std::vector<SeenLine> lines(const Eigen::Isometry3d& X_CB, double step_mm) {
    std::vector<SeenLine> out;
    const double half = 0.45 * board_.square_mm() * board_.rows();
    for (const auto& sheet : machine_.sheets) {
      SeenLine seen = line(sheet, X_CB.linear().col(2), X_CB.translation(), half, step_mm,
                           [&](const Eigen::Vector3d& p_C) { return bow_mm((X_CB.inverse() * p_C).head<2>()); });
      if (seen.points.size() > 20) out.push_back(std::move(seen));
    }
    return out;
  }
  /// Facing the camera but for a lean to a random side, the middle at a pixel and a depth.
  Eigen::Isometry3d pose(double x_px, double y_px, double depth_mm, double lean_rad) {
    const double side = uniform(0, 2 * std::numbers::pi);
    Eigen::Isometry3d X_CB = Eigen::Isometry3d::Identity();
    X_CB.linear() = (Eigen::AngleAxisd(lean_rad, Eigen::Vector3d(std::cos(side), std::sin(side), 0)) *
                     Eigen::AngleAxisd(uniform(-0.4, 0.4), Eigen::Vector3d::UnitZ()))
                        .toRotationMatrix();
    X_CB.translation() = depth_mm * Eigen::Vector3d((x_px - machine_.camera[2]) / machine_.camera[0],
                                                    (y_px - machine_.camera[3]) / machine_.camera[1], 1);
    return X_CB;
  }
  /// Standing on the platter, its face towards the azimuth, leaning back; about the axis but for an offset.
  Eigen::Isometry3d standing(double azimuth_rad, double lean_rad, double height_mm, Eigen::Vector2d offset_mm) const {
    const Eigen::Vector3d out(std::cos(azimuth_rad), std::sin(azimuth_rad), 0);
    const Eigen::Vector3d right = Eigen::Vector3d::UnitZ().cross(out);
    const Eigen::Vector3d z = -(std::cos(lean_rad) * out + std::sin(lean_rad) * Eigen::Vector3d::UnitZ());
    Eigen::Isometry3d X_WB = Eigen::Isometry3d::Identity();
    X_WB.linear() << right, z.cross(right), z;
    X_WB.translation() << offset_mm, height_mm;
    return X_WB;
  }

 private:
  double drawn(double sigma) const { return noise_.drawn ? sigma : 0.0; }

  TrueMachine machine_;
  TargetBoard board_;
  std::mt19937_64 random_;
  Noise noise_;
  std::uint64_t print_seed_;
};

/// How much is seen.
struct Programme {
  int board_views = 25, laser_views = 40, placements = 3, angles = 24;
  double angle_step_rad = 5 * kDegree, largest_lean_rad = 40 * kDegree, line_step_mm = 0.28;
  bool platter = true;
  /// Readings that each placement is seen at, too, one axis at a time; placements differ by a share of the distance.
  std::vector<double> elevations_rad = {}, lifts_mm = {};
  /// Each placement passes the camera at these speeds with these exposures, 15 frames over 40 degrees each time.
  struct Pass {
    double speed_rad_per_s, exposure_s;
  };
  std::vector<Pass> passes = {};
  double stamp_jitter_s = 0;  ///< standard deviation of each pass's own
};

/// What is seen of a machine; poses and noise from the seed.
inline CalibrationInput seen_of(const TrueMachine& machine, std::uint64_t seed, const Programme& programme = {},
                                const Noise& noise = {}) {
  CalibrationInput input{.board = TargetBoard(11, 8, 8, false), .views = {}, .platter = {}, .rim = {}};
  input.width_px = machine.width_px;
  input.height_px = machine.height_px;
  Viewer viewer(machine, input.board, seed, noise);
  const auto warm = [&] {
    if (machine.beyond.warming_rad > 0) viewer.machine().camera_turn_rad = machine.beyond.warming_rad * viewer.normal();
  };
  const auto held = [&](bool with_lines) {
    for (int attempt = 0; attempt < 10000; ++attempt) {
      const double spread = with_lines ? 0.25 : 0.5;
      const Eigen::Isometry3d X_CB =
          viewer.pose((0.5 + viewer.uniform(-spread, spread)) * machine.width_px,
                      (0.5 + viewer.uniform(-spread, spread)) * machine.height_px, viewer.uniform(250, 360),
                      viewer.uniform(0, programme.largest_lean_rad));
      if (!viewer.whole(X_CB)) continue;
      warm();
      BoardView view;
      view.corners = viewer.corners(X_CB);
      if (with_lines) view.lines = viewer.lines(X_CB, programme.line_step_mm);
      input.views.push_back(std::move(view));
      return;
    }
  };
  for (int i = 0; i < programme.board_views; ++i) held(false);
  for (int i = 0; i < programme.laser_views; ++i) held(true);
  struct Placement {
    int number;
    double middle_rad;
    Eigen::Isometry3d X_WB;
  };
  std::vector<Placement> placements;
  for (int placement = 0; placement < programme.placements; ++placement) {
    // Encoder angle at which the board faces the camera; the table is turned on from one placement to the next.
    const double middle = 2 * std::numbers::pi * placement / programme.placements + viewer.uniform(-0.3, 0.3);
    const Eigen::Isometry3d X_WB =
        viewer.standing(30 * kDegree - machine.direction * machine.encoder_scale * middle, viewer.uniform(0.1, 0.35),
                        viewer.uniform(42, 60), {viewer.uniform(-20, 20), viewer.uniform(-20, 20)});
    placements.push_back({placement, middle, X_WB});
    for (int k = 0; k < programme.angles; ++k) {
      warm();
      BoardView view;
      view.placement = placement;
      view.encoder_rad = middle + (k - 0.5 * (programme.angles - 1)) * programme.angle_step_rad;
      view.corners = viewer.corners(machine.turned(view.encoder_rad) * X_WB);
      input.views.push_back(std::move(view));
    }
  }
  for (const Placement& placed : placements) {
    std::vector<AxisStop> stops;
    for (double e : programme.elevations_rad) stops.push_back({e + 0.02 * placed.number, 0});
    for (double h : programme.lifts_mm) stops.push_back({0, h + 0.9 * placed.number});
    for (std::size_t k = 0; k < stops.size(); ++k) {
      warm();
      BoardView view;
      view.placement = placed.number;
      view.encoder_rad = placed.middle_rad + (static_cast<double>(k % 3) - 1) * 15 * kDegree;
      view.stop = stops[k];
      view.corners = viewer.corners(machine.turned(view.encoder_rad, view.stop) * placed.X_WB);
      input.views.push_back(std::move(view));
    }
  }
  for (const Placement& placed : placements) {
    for (const Programme::Pass& pass : programme.passes) {
      constexpr int kFrames = 15;
      const double late_s = programme.stamp_jitter_s * viewer.normal();
      BoardSweep sweep{.placement = placed.number, .views = {}};
      for (int k = 0; k < kFrames; ++k) {
        const double way = 40 * kDegree * (k - 0.5 * (kFrames - 1)) / (kFrames - 1);
        const double stamp_rad = placed.middle_rad + (pass.speed_rad_per_s < 0 ? -way : way);
        sweep.views.push_back({{stamp_rad, 1e-9, pass.speed_rad_per_s},
                               std::llround(pass.exposure_s * 1e9),
                               viewer.passing(placed.X_WB, stamp_rad + pass.speed_rad_per_s * late_s,
                                              pass.speed_rad_per_s, pass.exposure_s)});
      }
      input.sweeps.push_back(std::move(sweep));
    }
  }
  if (programme.platter) {
    const Eigen::Vector3d up_W =
        Eigen::Vector3d(-machine.platter_slope.x(), -machine.platter_slope.y(), 1).normalized();
    for (const auto& sheet : machine.sheets) {
      input.platter.push_back(
          viewer.line(sheet, machine.X_CW.linear() * up_W, machine.X_CW.translation(), 55, programme.line_step_mm));
    }
  }
  return input;
}

/// Solved minus true for every one of CalibrationSolution::names, in the charts that README.md gives them.
inline Eigen::VectorXd errors_of(const CalibrationSolution& solution, const TrueMachine& machine) {
  const Calibration& c = solution.calibration;
  std::vector<double> out;
  const CameraModel& m = c.camera_model;
  std::vector<double> camera = {m.fx_px.value, m.fy_px.value, m.cx_px.value, m.cy_px.value};
  for (const Measured& k : m.distortion) camera.push_back(k.value);
  for (std::size_t i = 0; i < 9; ++i) out.push_back(camera[i] - machine.camera[i]);
  out.insert(out.end(), 5, 0);  // of pitch and sag the calibration holds no value
  const Eigen::Isometry3d X_WC = c.axis.X_CW.inverse(), true_in_solved = X_WC * machine.X_CW;
  const Eigen::Vector3d direction = true_in_solved.linear().col(2), origin = true_in_solved.translation();
  const Eigen::Vector3d crossing = origin - direction * (origin.z() / direction.z());
  out.insert(out.end(), {-direction.x(), -direction.y(), -crossing.x(), -crossing.y()});
  out.push_back(c.encoder.scale.value - machine.encoder_scale);
  out.push_back(c.encoder.cos_rad.value - machine.encoder_cos_rad);
  out.push_back(c.encoder.sin_rad.value - machine.encoder_sin_rad);
  const Eigen::Vector3d up = c.axis.X_CW.linear().col(2), at = c.axis.X_CW.translation();
  for (const LaserPlane& plane : c.lasers) {
    for (const auto& sheet : machine.sheets) {
      if (sheet.laser != plane.laser) continue;
      Eigen::Vector3d n = machine.normal_C(sheet);
      double d = machine.distance_C(sheet);
      if (n.dot(plane.normal_C) < 0) {
        n = -n;
        d = -d;
      }
      const Eigen::Vector3d& solved = plane.normal_C;
      const Eigen::Vector3d in_plane = (up - solved * solved.dot(up)).normalized();
      const Eigen::Vector3d anchor = at + solved * (plane.distance_mm - solved.dot(at));
      out.insert(out.end(), {-in_plane.dot(n), -solved.cross(in_plane).dot(n), -(d - n.dot(anchor))});
    }
  }
  // The platter's height on the axis, from the solved origin; the calibration holds no slope.
  const bool axes = c.elevation || c.lift;
  if (out.size() + (c.elevation ? 5u : 0u) + (c.lift ? 3u : 0u) < solution.names.size()) {
    out.insert(out.end(), {-true_in_solved.translation().z(), 0, 0});
  }
  if (axes) {
    // The solved frame carried onto the true axis by the smallest turn, its origin to where the platter truly is: there
    // CALIBRATION.md compares elevation axis and lift.
    const Eigen::Matrix3d onto = Eigen::Quaterniond::FromTwoVectors(Eigen::Vector3d::UnitZ(), direction).matrix();
    const auto true_direction = [&](const Eigen::Vector3d& d_W) {
      return Eigen::Vector3d(onto.transpose() * true_in_solved.linear() * d_W);
    };
    if (c.elevation && machine.elevation) {
      const Eigen::Vector3d d = c.elevation->direction, o = c.elevation->origin_mm;
      const Eigen::Vector3d u = (Eigen::Vector3d::UnitZ() - d * d.z()).normalized(), v = d.cross(u);
      const Eigen::Vector3d e = true_direction(machine.elevation->direction_W);
      Eigen::Vector3d at_true = onto.transpose() * (true_in_solved * machine.elevation->origin_W - origin);
      at_true += e * (d.dot(o - at_true) / d.dot(e));  // where the true line passes the solved point
      out.insert(out.end(), {-u.dot(e), -v.dot(e), u.dot(o - at_true), v.dot(o - at_true),
                             c.elevation->scale.value - machine.elevation->scale});
    }
    if (c.lift && machine.lift) {
      const Eigen::Vector3d l = true_direction(machine.lift->direction_W), s = c.lift->direction;
      out.insert(out.end(), {s.x() - l.x(), s.y() - l.y(), c.lift->scale.value - machine.lift->scale});
    }
  }
  return Eigen::Map<Eigen::VectorXd>(out.data(), static_cast<Eigen::Index>(out.size()));
}

}  // namespace celadon::test
