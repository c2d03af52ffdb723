// The speed of the fit against its peers: ALGLIB, scipy, and a plain read of the same bytes. One run prints every line
// of the bar as measured/bar (at most 1 passes), from medians of interleaved runs. fitting_bench [--simd AVX2, SSE4
// ...] [points for the memory section = 10000000; "membership": that section alone]
#include <hwy/targets.h>
#include <libalglib/interpolation.h>
#include <malloc.h>

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <fstream>
#include <functional>
#include <random>
#include <span>
#include <string>
#include <vector>

#include "fitting/knot_selection.h"
#include "fitting/moment_kernels.h"
#include "fitting/regular_grid.h"
#include "fitting/signed_distance.h"
#include "fitting/solid_properties.h"
#include "fitting/surface_comparison.h"
#include "tests/bench/plain_read.h"
#include "tests/build_paths.h"
#include "tests/fitting/fit_tools.h"

namespace celadon {
namespace {

constexpr double kHeight = 120, kSigma = 0.02;
constexpr int kAround = 16;  // intervals an arc: 64 around
volatile double sink = 0;

// Of this thread's own processor time: every work here is one thread, and other programs shall not count.
double milliseconds(const std::function<void()>& work) {
  const auto now = [] {
    timespec t{};
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return 1e3 * static_cast<double>(t.tv_sec) + 1e-6 * static_cast<double>(t.tv_nsec);
  };
  const double start = now();
  work();
  return now() - start;
}

double median(std::vector<double> values) {
  std::nth_element(values.begin(), values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2), values.end());
  return values[values.size() / 2];
}

// Medians of each work in ms, run in turn.
std::vector<double> medians(int runs, const std::vector<std::function<void()>>& works) {
  std::vector<std::vector<double>> times(works.size());
  for (int run = -1; run < runs; ++run)
    for (std::size_t i = 0; i < works.size(); ++i) {
      const double t = milliseconds(works[i]);
      if (run >= 0) times[i].push_back(t);
    }
  std::vector<double> result;
  for (const auto& column : times) result.push_back(median(column));
  return result;
}

// The bars are those of AVX-512; narrower vectors may take longer.
double slack() {
  const std::string target = moment_kernels::target_name();
  if (target.rfind("AVX3", 0) == 0) return 1;
  return target == "AVX2" ? 1.5 : 6;
}

// As on a machine that has no wider vectors than those of the level named; false: this one has no such level.
bool use_simd_level(const std::string& name) {
  for (std::int64_t supported = hwy::SupportedTargets(); supported != 0; supported &= supported - 1) {
    const std::int64_t target = supported & -supported;
    if (hwy::TargetName(target) != name) continue;
    hwy::SetSupportedTargetsForTest(target);
    hwy::GetChosenTarget().Update(hwy::SupportedTargets());
    return true;
  }
  return false;
}

int lines_over = 0;
void verdict(const char* what, double measured_over_bar) {
  const bool over = measured_over_bar > 1;
  lines_over += over;
  std::printf("%-64s %6.2f%s\n", what, measured_over_bar, over ? "  OVER" : "");
}
// A cost that may be `bar` times its unit, and a speed that must be `bar` times the peer's.
void at_most(const char* what, double cost, double unit, double bar) {
  verdict(what, cost / unit / (bar * slack()));
}
void at_least(const char* what, double peer, double ours, double bar) {
  verdict(what, bar / slack() / (peer / ours));
}

void read_all(const std::vector<double>& values) {
  sink = sink + static_cast<double>(plain_read(values.data(), values.size()));
}

struct Points {
  std::vector<double> r, theta, z;
};
Points scattered_points(std::size_t n) {
  std::mt19937_64 random(12345);
  std::normal_distribution<double> noise(0, kSigma);
  std::uniform_real_distribution<double> share(0, 1);
  Points p;
  for (std::size_t k = 0; k < n; ++k) {
    p.theta.push_back(2 * test::kPi * share(random));
    p.z.push_back(kHeight * share(random));
    p.r.push_back(test::freeform(p.theta.back(), p.z.back()) + noise(random));
  }
  return p;
}
// side x side samples, each with an angle of its own, profile after profile.
Points scan_order_points(std::size_t side) {
  std::mt19937_64 random(6789);
  std::normal_distribution<double> noise(0, kSigma);
  std::uniform_real_distribution<double> share(0, 1);
  Points p;
  const double n = static_cast<double>(side);
  for (std::size_t i = 0; i < side; ++i)
    for (std::size_t j = 0; j < side; ++j) {
      p.theta.push_back(2 * test::kPi * (static_cast<double>(i) + 0.5 * share(random)) / n);
      p.z.push_back(kHeight * (static_cast<double>(j) + share(random)) / n);
      p.r.push_back(test::freeform(p.theta.back(), p.z.back()) + noise(random));
    }
  return p;
}

// 64 x 32 unknowns: 64 around in the curvature-continuous space, 29 intervals of z have 32.
GridSpecification grid_of(int z_intervals, int intervals_per_arc) {
  return {0, kHeight, z_intervals, intervals_per_arc, 3, 3};
}
FitSpace space_of(const MomentGrid& sums) {
  return FitLadder(sums, {0, sums.z_cells()}, 3, 3, JointContinuity::curvature).space(0, 0);
}

RangeFunction solved(const NormalEquations& equations, double smoothing = 0) {
  const auto free = NormalSolver(equations, smoothing).solve();
  if (!free) {
    std::fprintf(stderr, "fitting_bench: a system could not be solved\n");
    std::exit(1);
  }
  return range_function(equations, *free);
}
RangeFunction solved(const MomentGrid& sums, double smoothing = 0) {
  return solved(NormalEquations(sums, space_of(sums)), smoothing);
}
double rms(const RangeFunction& f) {
  return test::miss(f, test::freeform).rms;
}

// ALGLIB's scattered bicubic least squares, an open strip of 64 x 32 nodes.
struct AlglibFit {
  alglib::real_2d_array points;
  double penalty;
  alglib::spline2dinterpolant result;
  AlglibFit(const Points& p, double lambda) : penalty(lambda) {
    points.setlength(static_cast<alglib::ae_int_t>(p.r.size()), 3);
    for (std::size_t k = 0; k < p.r.size(); ++k) {
      const auto row = static_cast<alglib::ae_int_t>(k);
      points(row, 0) = p.theta[k], points(row, 1) = p.z[k], points(row, 2) = p.r[k];
    }
  }
  void run() {
    alglib::spline2dbuilder builder;
    alglib::spline2dbuildercreate(1, builder);
    alglib::spline2dbuildersetpoints(builder, points, points.rows());
    alglib::spline2dbuildersetgrid(builder, 64, 32);
    alglib::spline2dbuildersetarea(builder, 0, 2 * test::kPi, 0, kHeight);
    alglib::spline2dbuildersetalgoblocklls(builder, penalty);
    alglib::spline2dfitreport report;
    alglib::spline2dfit(builder, result, report);
  }
  double rms() const {
    double square = 0, count = 0;
    for (int i = 0; i < 211; ++i)
      for (int j = 0; j <= 120; ++j, ++count) {
        const double t = 2 * test::kPi * (i + 0.37) / 211, z = kHeight * j / 120;
        square += std::pow(alglib::spline2dcalc(result, t, z) - test::freeform(t, z), 2);
      }
    return std::sqrt(square / count);
  }
};

void scattered() {
  const Points p = scattered_points(1'000'000);
  AlglibFit peer(p, 1e-9);
  RangeFunction f;
  // The same number of points and unknowns over part of a turn, and over a sphere.
  const BaseArcs part = BaseArcs::open(0.3, 4);
  Points of_part = p, of_sphere = p;
  for (std::size_t k = 0; k < p.r.size(); ++k) {
    of_part.theta[k] = 0.3 + 4 * p.theta[k] / (2 * test::kPi);
    of_sphere.z[k] = BaseSurface::kMeridianEnd * p.z[k] / kHeight;
  }
  const auto t = medians(3, {[&] { peer.run(); },
                             [&] {
                               MomentGrid sums(grid_of(32, kAround));
                               sums.add(p.r, p.theta, p.z);
                               f = solved(sums);
                             },
                             [&] {
                               GridSpecification grid = grid_of(32, kAround);
                               grid.arcs = part;
                               MomentGrid sums(grid);
                               sums.add(of_part.r, of_part.theta, of_part.z);
                               solved(sums);
                             },
                             [&] {
                               GridSpecification grid = grid_of(32, kAround);
                               grid.z_end_mm = BaseSurface::kMeridianEnd;
                               grid.base = BaseKind::sphere;
                               MomentGrid sums(grid);
                               sums.add(of_sphere.r, of_sphere.theta, of_sphere.z);
                               solved(sums);
                             }});
  std::printf("1M scattered points: %.1f ms, RMS %.2e; ALGLIB BlockLLS %.0f ms, RMS %.2e: %.1f times as fast\n", t[1],
              rms(f), t[0], peer.rms(), t[0] / t[1]);
  at_least("1M scattered points at least 50 x ALGLIB", t[0], t[1], 50);
  std::printf("the same over 4 rad of the turn: %.1f ms; over a sphere: %.1f ms\n", t[2], t[3]);
  at_least("1M scattered points over an open range, likewise", t[0], t[2], 50);
  at_least("1M scattered points over a sphere, likewise", t[0], t[3], 50);
}

void few_points() {
  const Points p = scattered_points(10'000);
  AlglibFit peer(p, 1e-3);
  test::MemoryStream stream = test::scattered(test::freeform, 10'000, kSigma);
  RangeFunction fixed, automatic;
  const auto t = medians(9, {[&] { peer.run(); },
                             [&] {
                               MomentGrid sums(grid_of(32, kAround));
                               sums.add(p.r, p.theta, p.z);
                               fixed = solved(sums, 1e-6);
                             },
                             [&] { automatic = test::fit(stream)->function; }});
  std::printf(
      "10k scattered points at a fixed weight: %.2f ms, RMS %.2e; ALGLIB %.1f ms, RMS %.2e: %.1f times as fast\n", t[1],
      rms(fixed), t[0], peer.rms(), t[0] / t[1]);
  std::printf("  model, knots and smoothing chosen from the samples: %.1f ms, RMS %.2e\n", t[2], rms(automatic));
  at_least("10k points at least 8 x ALGLIB at a fixed weight", t[0], t[1], 8);
}

struct Scan {
  std::size_t side = 1000;
  std::vector<double> theta, samples, xyz;  // z, then r of each profile of one theta; all x, all y, all z
  Scan() {
    const Points p = scan_order_points(side);
    std::mt19937_64 random(1);
    std::normal_distribution<double> noise(0, kSigma);
    for (std::size_t i = 0; i < side; ++i) {
      theta.push_back(2 * test::kPi * (static_cast<double>(i) + 0.5) / static_cast<double>(side));
      const auto z = std::span(p.z).subspan(i * side, side);
      samples.insert(samples.end(), z.begin(), z.end());
      for (const double height : z) samples.push_back(test::freeform(theta[i], height) + noise(random));
    }
    for (std::size_t k = 0; k < p.r.size(); ++k) xyz.push_back(p.r[k] * std::cos(p.theta[k]));
    for (std::size_t k = 0; k < p.r.size(); ++k) xyz.push_back(p.r[k] * std::sin(p.theta[k]));
    xyz.insert(xyz.end(), p.z.begin(), p.z.end());
  }
  void add_profiles(MomentGrid& sums) const {
    const std::span<const double> all(samples);
    for (std::size_t i = 0; i < side; ++i)
      sums.add_constant_theta(theta[i], all.subspan((2 * i + 1) * side, side), all.subspan(2 * i * side, side));
  }
  void add_cartesian(MomentGrid& sums) const {
    const std::span<const double> all(xyz);
    const std::size_t n = side * side;
    sums.add_cartesian(all.first(n), all.subspan(n, n), all.last(n));
  }
};

void scans(const Scan& scan) {
  const auto t = medians(9, {[&] { read_all(scan.samples); },
                             [&] {
                               MomentGrid sums(grid_of(32, kAround));
                               scan.add_profiles(sums);
                             },
                             [&] { read_all(scan.xyz); },
                             [&] {
                               MomentGrid sums(grid_of(32, kAround));
                               scan.add_cartesian(sums);
                             }});
  std::printf("1M samples in profiles of one theta: %.2f ns a sample, plain read %.2f ns: ratio %.2f\n", t[1], t[0],
              t[1] / t[0]);
  std::printf("1M points x, y, z in scan order: %.2f ns a point, plain read %.2f ns: ratio %.1f\n", t[3], t[2],
              t[3] / t[2]);
  at_most("profiles at most 4.5 x the plain read", t[1], t[0], 4.5);
  at_most("scan-order xyz at most 20 x the plain read", t[3], t[2], 20);
}

void surfaces(const Scan& scan) {
  MomentGrid coarse(grid_of(32, kAround)), fine(grid_of(64, 2 * kAround));
  scan.add_profiles(coarse);
  scan.add_profiles(fine);
  const NormalEquations kept_coarse(coarse, space_of(coarse)), kept_fine(fine, space_of(fine));
  RangeFunction f;
  NurbsSurface surface;
  std::vector<double> theta, z, r(scan.side);
  for (std::size_t k = 0; k < scan.side; ++k) {
    theta.push_back(scan.theta[0]);
    z.push_back(scan.samples[k]);
  }
  const auto t = medians(
      15, {[&] { read_all(scan.samples); }, [&] { surface = symbolic_product(solved(kept_coarse)); },
           [&] { surface = symbolic_product(f = solved(coarse)); },
           [&] { surface = symbolic_product(solved(kept_fine)); }, [&] { surface = symbolic_product(solved(fine)); },
           [&] { surface = symbolic_product(f); }, [&] { f.evaluate(theta.data(), z.data(), r.size(), r.data()); },
           [&] {
             for (std::size_t k = 0; k < r.size(); ++k)
               sink = sink + surface.evaluate(z[k] / kHeight, scan.theta[k] / test::kPi * 2).x();
           }});
  const FitSpace space = space_of(coarse), large = space_of(fine);
  std::printf(
      "sums to exact surface, %d x %d: %.2f ms, matrix kept %.2f ms; %d x %d: %.2f ms, kept %.2f ms; RMS %.2e\n",
      space.v.free_count(), space.u.free_count(), t[2], t[1], large.v.free_count(), large.u.free_count(), t[4], t[3],
      rms(f));
  std::printf(
      "symbolic product of %d x %d: %.2f ms; F at points of one theta: %.1f ns each; a surface point: %.0f ns\n",
      space.v.free_count(), space.u.free_count(), t[5], 1e6 * t[6] / static_cast<double>(r.size()),
      1e6 * t[7] / static_cast<double>(r.size()));
  at_most("64 x 32, matrix kept, at most 3.5 x the plain read", t[1], t[0], 3.5);
  at_most("64 x 32 from sums at most 7 x the plain read", t[2], t[0], 7);
  at_most("128 x 64, matrix kept, at most 4 x that of 64 x 32", t[3], t[0], 4 * 3.5);
  at_most("128 x 64 from sums at most 4 x that of 64 x 32", t[4], t[0], 4 * 7);
}

// Points of the scanner frame against a fitted surface of 64 x 35, in scan order and in none.
void membership(const Scan& scan) {
  MomentGrid sums(grid_of(32, kAround));
  scan.add_profiles(sums);
  const RangeFunction f = solved(sums);
  const SignedDistance distance(f);
  const std::size_t n = scan.side * scan.side;
  const Points anywhere = scattered_points(n);
  std::vector<double> loose(3 * n), result(n);
  for (std::size_t k = 0; k < n; ++k) {
    loose[k] = anywhere.r[k] * std::cos(anywhere.theta[k]);
    loose[n + k] = anywhere.r[k] * std::sin(anywhere.theta[k]);
    loose[2 * n + k] = anywhere.z[k];
  }
  const auto along_ray = [&](const std::vector<double>& p) {
    distance.along_ray(p.data(), p.data() + n, p.data() + 2 * n, n, result.data());
    sink = sink + result[n / 2];
  };
  const auto to_surface = [&](const std::vector<double>& p) {
    distance.to_surface(p.data(), p.data() + n, p.data() + 2 * n, n, result.data());
    sink = sink + result[n / 2];
  };
  const auto t = medians(15, {[&] { read_all(scan.xyz); }, [&] { along_ray(scan.xyz); }, [&] { to_surface(scan.xyz); },
                              [&] { along_ray(loose); }, [&] { to_surface(loose); }});
  std::printf(
      "1M points against a surface, in scan order: along the ray %.1f ns, signed distance %.1f ns; plain read "
      "%.2f ns: ratios %.2f, %.2f\n",
      t[1], t[2], t[0], t[1] / t[0], t[2] / t[0]);
  std::printf("1M points in no order: along the ray %.1f ns, signed distance %.1f ns: ratios %.2f, %.2f\n", t[3], t[4],
              t[3] / t[0], t[4] / t[0]);
  at_most("membership of points in scan order at most 3 x the plain read", t[1], t[0], 3);
  at_most("signed distance of points in scan order at most 3 x the plain read", t[2], t[0], 3);

  const NurbsSurface surface = symbolic_product(f);
  const RangeFunction other(f.base(), 3, 3, f.knots_u(), f.knots_v(), f.coefficients().array() + 0.1);
  SolidProperties solid;
  const auto once =
      medians(5, {[&] { solid = solid_properties(surface); }, [&] { sink = sink + compare(f, other)->rms_mm; }});
  std::printf("solid of the surface: %.0f ms, quadrature to %.0e; comparison of two: %.1f ms\n", once[0],
              solid.relative_error, once[1]);
}

// scipy runs as a program of its own, its fits timed inside; turns are taken run by run.
void regular_grid() {
  const std::string folder = CELADON_BIN_DIR "/../scipy", source = CELADON_SOURCE_DIR "/tests/bench/";
  const auto peer = [&](double& time_ms, double& miss_mm) {
    std::FILE* out = popen((folder + "/python3 " + source + "separable_fit.py 5").c_str(), "r");
    const bool read = out && std::fscanf(out, "%lf %lf", &time_ms, &miss_mm) == 2;
    return out && pclose(out) == 0 && read;
  };
  Eigen::Matrix<double, -1, -1, Eigen::RowMajor> r(1000, 1000);
  std::vector<double> z;
  std::mt19937_64 random(3);
  std::normal_distribution<double> noise(0, kSigma);
  for (int j = 0; j < 1000; ++j) z.push_back(kHeight * j / 999);
  for (int i = 0; i < 1000; ++i)
    for (int j = 0; j < 1000; ++j)
      r(i, j) = test::freeform(2 * test::kPi * i / 1000, z[static_cast<std::size_t>(j)]) + noise(random);
  const FitSpace space = space_of(MomentGrid(grid_of(32, kAround)));
  std::vector<double> ours, theirs;
  RangeFunction f;
  double peer_ms = 0, peer_miss = 0;
  bool there = std::system((source + "fetch_scipy " + folder + " >/dev/null 2>&1").c_str()) == 0;
  for (int run = 0; run < 5; ++run) {
    for (int k = 0; k < 5; ++k)
      ours.push_back(milliseconds([&] { f = fit_regular_grid(space, BaseArcs::full_circle(), r, 0, z).value(); }));
    there = there && peer(peer_ms, peer_miss);
    theirs.push_back(peer_ms);
  }
  std::printf("grid 1000 x 1000: %.2f ms, RMS %.2e", median(ours), rms(f));
  if (!there) {
    std::printf("\nNO SCIPY: tests/bench/fetch_scipy %s failed, the grid's bar is not measured\n", folder.c_str());
    ++lines_over;
    return;
  }
  std::printf("; scipy %.1f ms, RMS %.2e: %.1f times as fast\n", median(theirs), peer_miss,
              median(theirs) / median(ours));
  at_least("grid 1000 x 1000 at least 10 x scipy", median(theirs), median(ours), 10);
}

// Peak of the resident memory of a whole fit beyond what was there before, in MB. The points are handed over again and
// again.
double peak_megabytes(const Points& points, std::size_t count) {
  const auto status = [](const char* key) {
    std::ifstream file("/proc/self/status");
    for (std::string line; std::getline(file, line);)
      if (line.rfind(key, 0) == 0) return std::atof(line.c_str() + std::strlen(key)) / 1024;
    return 0.0;
  };
  malloc_trim(0);
  std::ofstream("/proc/self/clear_refs") << 5;  // the peak starts anew
  const double before = status("VmRSS:");
  MomentGrid sums(grid_of(32, kAround));
  for (std::size_t k = 0; k < count; k += points.r.size()) sums.add(points.r, points.theta, points.z);
  sink = sink + symbolic_product(solved(sums)).control_points(0, 0);
  return status("VmHWM:") - before;
}

void memory(double most) {
  const Points p = scattered_points(1'000'000);
  std::printf("memory beyond the input:");
  double largest = 0, first = 0;
  for (double count = 1e6; count <= most; count *= 10) {
    const double mb = peak_megabytes(p, static_cast<std::size_t>(count));
    std::printf(" %.1f MB at %.0fM points", mb, count / 1e6);
    largest = std::max(largest, mb);
    if (count == 1e6) first = mb;
  }
  std::printf("\n");
  verdict("memory at most 8 MB", largest / 8);
  verdict("memory grows with the number of points by at most 1 MB", largest - first);
}

}  // namespace
}  // namespace celadon

int main(int argc, char** argv) {
  using namespace celadon;
  if (argc > 2 && std::string(argv[1]) == "--simd") {
    if (!use_simd_level(argv[2])) {
      std::fprintf(stderr, "fitting_bench: this machine has no SIMD level %s\n", argv[2]);
      return 2;
    }
    argc -= 2, argv += 2;
  }
  std::printf("SIMD level %s: the bars for AVX-512 times %.1f\n", moment_kernels::target_name(), slack());
  std::printf("measured / bar, at most 1 passes\n\n");
  if (argc > 1 && std::string(argv[1]) == "membership") {
    membership(Scan());
    return 0;
  }
  memory(argc > 1 ? std::atof(argv[1]) : 1e7);
  {
    const Scan scan;
    scans(scan);
    surfaces(scan);
    membership(scan);
  }
  regular_grid();
  few_points();
  scattered();
  std::printf("\n%d lines over their bar or not measured\n", lines_over);
  return 0;
}
