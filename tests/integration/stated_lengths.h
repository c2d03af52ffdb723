#pragma once
// Whole calibrations by machines that do more than the model holds, scans of known objects with them, and the sizes
// stated for the objects against the true ones.

#include <cmath>
#include <cstdio>
#include <string>
#include <vector>

#include "daemon/dimensions.h"
#include "tests/acquisition/calibrate/scanned_object.h"

namespace celadon::test {

/// One stated size over many calibrations.
struct StatedSize {
  std::string name, unit;
  int count = 0, covered = 0;  ///< by k = 2
  double squares = 0, stated = 0;

  void add(double error, double u) {
    ++count;
    covered += std::abs(error) <= 2 * u;
    squares += error * error;
    stated += u;
  }
  double rms() const { return std::sqrt(squares / count); }
  double mean_u() const { return stated / count; }
  double coverage() const { return static_cast<double>(covered) / count; }
};

/// What the machines of this test do beyond the model: standard deviations from machine to machine.
struct BeyondSizes {
  double bow_mm = 0.03, print_mm = 0.003, ripple_px = 0.01, sheet_bow_mm = 0.005;  ///< the sheet's at 50 mm
  double spindle_mm = 0.002, wobble_rad = 2e-5, encoder_rad = 5e-5;
  double line_bias_px = 0.02, corner_bias_px = 0.01, warming_rad = 1e-5;
  double u_pitch = 2e-4;
};

/// A machine and its print, drawn.
inline TrueMachine drawn_machine(std::uint64_t seed, const BeyondSizes& sizes) {
  std::mt19937_64 random(seed * 7919 + 17);
  std::normal_distribution<double> normal;
  TrueMachine machine;
  machine.pitch = {1 + sizes.u_pitch * normal(random), 1 + sizes.u_pitch * normal(random)};
  BeyondModel& beyond = machine.beyond;
  beyond.bow_mm = sizes.bow_mm * normal(random);
  beyond.print_mm = sizes.print_mm;
  beyond.ripple_px = sizes.ripple_px * normal(random);
  beyond.sheet_bow_per_mm = sizes.sheet_bow_mm / 2500 * normal(random);
  beyond.radial_mm = sizes.spindle_mm * normal(random);
  beyond.axial_mm = sizes.spindle_mm * normal(random);
  beyond.wobble_rad = sizes.wobble_rad * normal(random);
  beyond.encoder_rad = sizes.encoder_rad * normal(random);
  beyond.phase_rad = 7 * normal(random);
  beyond.line_bias_px = sizes.line_bias_px;
  beyond.corner_bias_px = sizes.corner_bias_px;
  beyond.warming_rad = sizes.warming_rad;
  return machine;
}

/// The drift's part of a radius: the camera 300 mm away and 30 degrees beside the sheet.
inline double drift_mm(const BeyondSizes& sizes) {
  return sizes.warming_rad * 300 / std::sin(30 * kDegree);
}

class StatedLengths {
 public:
  explicit StatedLengths(BeyondSizes sizes = {}) : sizes_(sizes) {}

  /// One calibration, and scans of a cylinder, of a taper and of a sphere at three places.
  /// @returns the error if there was none
  std::string add(std::uint64_t seed, const Programme& programme = {}) {
    TrueMachine machine = drawn_machine(seed, sizes_);
    CalibrationInput input = seen_of(machine, seed, programme);
    input.pitch_x = input.pitch_y = {1, sizes_.u_pitch};
    const auto solution = solve_calibration(input);
    if (!solution) return solution.error();
    refused_ += solution->verdict == Verdict::refused;
    inflation_ += std::sqrt(solution->chi_square / solution->degrees_of_freedom);
    Calibration calibration = solution->calibration;
    calibration.u_drift_mm = drift_mm(sizes_);
    std::mt19937_64 random(seed * 104729 + 5);
    std::uniform_real_distribution<double> uniform(-1, 1);
    const auto placed = [&](RoundObject object) {
      const Eigen::Vector3d lean(uniform(random), uniform(random), 0);
      object.X_TO.linear() = Eigen::AngleAxisd(0.01 * lean.norm(), lean.normalized()).toRotationMatrix();
      object.X_TO.translation() << 6 * uniform(random), 6 * uniform(random), 0;
      return object;
    };
    std::uint64_t scan = seed * 16;
    const auto scanned = [&](RoundShape shape, const RoundObject& object) {
      return dimensions_of(shape, scan_of(machine, calibration, 0, object, ++scan), calibration, 60);
    };
    const auto cylinder = scanned(RoundShape::cylinder, placed(cylinder_of(50)));
    if (!cylinder) return "cylinder: " + cylinder.error();
    of("cylinder, diameter 100 mm", "mm").add(cylinder->values[0].value - 100, cylinder->values[0].u);

    const double slope = std::tan(3 * kDegree);
    const RoundObject leaning = placed(taper_of(40, slope));
    const auto taper = scanned(RoundShape::cone, leaning);
    if (!taper) return "taper: " + taper.error();
    // Where the taper's axis passes the height of 60 mm.
    const double h = 60 / leaning.X_TO.linear()(2, 2) - 60;
    of("taper, diameter at 60 mm, 80 mm", "mm").add(taper->values[0].value - 2 * (40 + slope * h), taper->values[0].u);
    of("taper, cone angle 6 degrees", "rad").add(taper->values[1].value - 6 * kDegree, taper->values[1].u);

    std::vector<Dimension> spheres;
    for (const double height : {40.0, 60.0, 80.0}) {
      const auto sphere = scanned(RoundShape::sphere, placed(sphere_of(25, height)));
      if (!sphere) return "sphere: " + sphere.error();
      of("sphere, diameter 50 mm, at three places", "mm").add(sphere->values[0].value - 50, sphere->values[0].u);
      spheres.push_back(sphere->values[0]);
    }
    for (std::size_t i = 0; i < 3; ++i) {
      const Dimension &a = spheres[i], &b = spheres[(i + 1) % 3];
      ++pairs_;
      agree_ += std::abs(a.value - b.value) <= 2 * std::hypot(a.u, b.u);
    }
    return {};
  }

  const std::vector<StatedSize>& sizes() const { return stated_; }
  /// Over all values: share covered by k = 2, and mean of U over twice the rms error, lengths alone.
  double pooled_coverage() const {
    int covered = 0, count = 0;
    for (const StatedSize& size : stated_) {
      covered += size.covered;
      count += size.count;
    }
    return static_cast<double>(covered) / count;
  }
  double pooled_excess() const {
    double squares = 0, stated = 0;
    int count = 0;
    for (const StatedSize& size : stated_) {
      if (size.unit != "mm") continue;
      squares += size.squares;
      stated += size.stated;
      count += size.count;
    }
    return stated / count / std::sqrt(squares / count);
  }
  double agreement() const { return static_cast<double>(agree_) / pairs_; }
  int refused() const { return refused_; }
  double mean_inflation() const { return inflation_ / stated_.front().count; }

 private:
  StatedSize& of(const std::string& name, const std::string& unit) {
    for (StatedSize& size : stated_) {
      if (size.name == name) return size;
    }
    stated_.push_back({name, unit});
    return stated_.back();
  }

  BeyondSizes sizes_;
  std::vector<StatedSize> stated_;
  int pairs_ = 0, agree_ = 0, refused_ = 0;
  double inflation_ = 0;
};

}  // namespace celadon::test
