#pragma once
// Simulated scans of bodies in closed form, again and again: how often the stated standard deviation of the surface
// covers the truth. Shared by the test (a seeded sample) and the campaign that counts.

#include <cmath>
#include <string>
#include <vector>

#include "tests/fitting/fit_tools.h"
#include "tests/fitting/sphere_tools.h"

namespace celadon::test {

struct CoverageScenario {
  std::string name;
  int profiles = 200, rows = 200;
  double correlation = 0;    ///< AR(1) along the line
  double profile_sigma = 0;  ///< an error common to each profile, mm
  double contrast = 1;       ///< noise on one side of the body over that on the other
  bool stated = false;       ///< with the covariance of each sample
  bool hole = false;         ///< no samples in a window of 46 degrees by 30 mm
  bool open = false;         ///< 200 degrees of the turn alone
  bool sphere = false;       ///< a sphere off its centre with lobes, both poles closed; scattered samples
  double outliers = 0;       ///< share of samples that lie anywhere
  bool no_finer = false;     ///< the sums have no finer knots around: what the knots miss is stated as a bound
  bool fixed = false;        ///< 32 x 64 intervals, which follow the body to 0.1 um
};

inline constexpr double kCoverageSigma = 0.02;

inline std::vector<CoverageScenario> coverage_scenarios() {
  return {{.name = "white"},
          {.name = "AR 0.5 along the line", .correlation = 0.5},
          {.name = "AR 0.5, 10 um a profile", .correlation = 0.5, .profile_sigma = 0.01},
          {.name = "noise 1:5 around", .contrast = 5},
          {.name = "noise 1:5, stated", .contrast = 5, .stated = true},
          {.name = "hole", .hole = true},
          {.name = "hole, AR 0.5, noise 1:5", .correlation = 0.5, .contrast = 5, .hole = true},
          {.name = "10 % outliers", .outliers = 0.1},
          {.name = "open range, AR 0.5", .correlation = 0.5, .open = true},
          {.name = "sphere with poles", .sphere = true},
          {.name = "sphere, noise 1:5", .contrast = 5, .sphere = true},
          {.name = "10 000 samples", .profiles = 100, .rows = 100, .no_finer = true},
          {.name = "fixed knots, no smoothing", .fixed = true}};
}

inline constexpr double kCoverageOpenStart = 0.3, kCoverageOpenRange = 200 * kPi / 180;
inline bool in_hole(double theta, double z) {
  return theta > 1.0 && theta < 1.8 && z > 40 && z < 70;
}

inline double coverage_sigma(const CoverageScenario& s, double theta) {
  return kCoverageSigma * std::pow(s.contrast, (1 + std::sin(theta)) / 2 - 0.5);
}

inline double lobed_sphere(double phi, double theta) {
  const double s = std::sin(phi);
  static const Body off_centre = off_centre_sphere(25, Eigen::Vector3d(1, 0.5, 2));
  return off_centre(phi, theta) + s * s * (1.0 * std::cos(2 * theta) + 0.4 * std::cos(3 * phi));
}

inline MemoryStream coverage_scan(const CoverageScenario& s, unsigned seed) {
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> share(0, 1);
  MemoryStream stream;
  const double begin = s.open ? kCoverageOpenStart : 0, range = s.open ? kCoverageOpenRange : 2 * kPi;
  for (int i = 0; i < s.profiles; ++i) {
    Profile p;
    p.index = static_cast<std::uint32_t>(i);
    if (s.sphere) p.order = ProfileOrder::scattered;
    const double theta = begin + range * (i + 0.5) / s.profiles, common = s.profile_sigma * normal(random);
    double e = normal(random);
    for (int j = 0; j < s.rows; ++j) {
      if (j) e = s.correlation * e + std::sqrt(1 - s.correlation * s.correlation) * normal(random);
      if (s.sphere) {  // even over the directions
        const double c = 1 - 2 * share(random), phi = std::acos(c), t = 2 * kPi * share(random);
        const double rho = lobed_sphere(phi, t) + coverage_sigma(s, t) * normal(random);
        push(p, rho * std::sin(phi), t, rho * c);
        continue;
      }
      const double z = 120.0 * j / (s.rows - 1), sigma = coverage_sigma(s, theta);
      if (s.hole && in_hole(theta, z)) continue;
      double r = freeform(theta, z) + sigma * e + common;
      if (s.outliers > 0 && share(random) < s.outliers) r = 20 + 30 * share(random);
      push(p, r, theta, z);
      p.row.push_back(static_cast<std::uint16_t>(j));
      if (s.stated) p.covariance.push_back({.rr = static_cast<float>(sigma * sigma)});
    }
    stream.profiles.push_back(std::move(p));
  }
  return stream;
}

/// Sums over runs at the points of a grid.
struct CoverageCount {
  struct Point {
    double theta, along;
    bool unseen;
    double error = 0, square = 0, stated = 0, covered = 0;
  };
  std::vector<Point> points;
  int runs = 0;
  double kappa = 0;

  explicit CoverageCount(const CoverageScenario& s) {
    const double begin = s.open ? kCoverageOpenStart : 0, range = s.open ? kCoverageOpenRange : 2 * kPi;
    for (int i = 0; i < 24; ++i)
      for (int j = 0; j < 36; ++j) {
        const double theta = begin + range * (j + 0.41) / 36;
        const double along =
            s.sphere ? BaseSurface::meridian().v_of_theta(std::acos(1 - 2 * (i + 0.5) / 24)) : 120 * (i + 0.5) / 24;
        points.push_back({theta, along, s.hole && in_hole(theta, along)});
      }
  }

  void add(const CoverageScenario& s, const RangeFit& fit) {
    ++runs;
    kappa += fit.report.kappa;
    for (Point& p : points) {
      const double phi = s.sphere ? BaseSurface::meridian().theta_of_v(p.along) : 0;
      const double truth = s.sphere ? lobed_sphere(phi, p.theta) : freeform(p.theta, p.along);
      const double e = fit.function(p.theta, p.along) - truth;
      const double sd = (*fit.deviation)(fit.function.base().arcs.v_of_theta(p.theta), p.along);
      p.error += e;
      p.square += e * e;
      p.stated += sd * sd;
      p.covered += std::abs(e) <= 2 * sd;
    }
  }

  /// Over the points that samples surround, and over the others.
  struct Result {
    double stated = 0, observed = 0, scatter = 0;  ///< RMS, mm; observed: about the truth, scatter: about the mean
    double covered = 0, least = 1;                 ///< share within two standard deviations; at the worst point
  };
  Result result(bool unseen) const {
    Result r;
    double n = 0;
    for (const Point& p : points) n += p.unseen == unseen;
    for (const Point& p : points) {
      if (p.unseen != unseen) continue;
      r.stated += p.stated / runs / n;
      r.observed += p.square / runs / n;
      r.scatter += (p.square - p.error * p.error / runs) / (runs - 1) / n;
      r.covered += p.covered / runs / n;
      r.least = std::min(r.least, p.covered / runs);
    }
    r.stated = std::sqrt(r.stated), r.observed = std::sqrt(r.observed), r.scatter = std::sqrt(r.scatter);
    return r;
  }
};

inline tl::expected<RangeFit, FitError> coverage_fit(const CoverageScenario& s, unsigned seed) {
  MemoryStream stream = coverage_scan(s, seed);
  RangeFitOptions options;
  if (s.fixed) options.z_intervals = 32, options.intervals_per_arc = 16, options.smoothing = false;
  if (s.open) options.arcs = BaseArcs::open(kCoverageOpenStart, kCoverageOpenRange);
  return s.sphere ? fit_sphere(stream, options) : fit(stream, options);
}

}  // namespace celadon::test
