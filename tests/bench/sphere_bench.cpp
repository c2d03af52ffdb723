// A freeform body over a sphere from scattered samples: time and accuracy beside FITPACK's sphere spline and ALGLIB, at
// equal numbers of coefficients. sphere_bench [samples = 100000]
#include <libalglib/interpolation.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <fstream>
#include <numbers>
#include <random>
#include <string>
#include <vector>

#include "fitting/fit_ladder.h"
#include "fitting/normal_solver.h"
#include "tests/build_paths.h"
#include "tests/fitting/sphere_tools.h"
#include "tests/temporary_folder.h"

namespace {

using celadon::test::kPi;

constexpr double kSigma_mm = 0.02;
constexpr int kAround = 32, kAlong = 32;  // intervals: 32 around, 32 along

double cpu_seconds() {
  timespec t{};
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
  return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}

// Tilted at both poles, with lobes.
double body(double phi, double theta) {
  const double x = std::sin(phi) * std::cos(theta), y = std::sin(phi) * std::sin(theta), z = std::cos(phi);
  return 25 + 2 * x + y + 3 * x * y + 1.5 * x * x * x - 2 * y * y * z + 0.8 * (x * x - y * y) * z;
}

struct Sample {
  double phi, theta, rho;
};
std::vector<Sample> samples_of(std::size_t count, double sigma, unsigned seed) {
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal(0, 1);
  std::uniform_real_distribution<double> share(0, 1);
  std::vector<Sample> samples(count);
  for (Sample& s : samples) {
    s.phi = std::acos(1 - 2 * share(random));
    s.theta = 2 * kPi * share(random);
    s.rho = body(s.phi, s.theta) + sigma * normal(random);
  }
  return samples;
}

struct Result {
  double seconds = 0, coefficients = 0, rms = 0, largest = 0, tear = 0;
};

template <class Function>
void judge(Result& result, const std::vector<Sample>& check, const Function& rho) {
  double square = 0;
  for (const Sample& s : check) {
    const double e = rho(s.phi, s.theta) - s.rho;
    square += e * e;
    result.largest = std::max(result.largest, std::abs(e));
  }
  result.rms = std::sqrt(square / static_cast<double>(check.size()));
  for (const double pole : {0.0, kPi}) {
    double low = 1e300, high = -1e300;
    for (int k = 0; k < 90; ++k) {
      const double value = rho(pole, 2 * kPi * k / 90);
      low = std::min(low, value), high = std::max(high, value);
    }
    result.tear = std::max(result.tear, high - low);
  }
}

Result ours(const std::vector<Sample>& samples, const std::vector<Sample>& check) {
  const celadon::BaseArcs& meridian = celadon::BaseSurface::meridian();
  std::vector<double> rho, theta, phi, w(samples.size());
  for (const Sample& s : samples) rho.push_back(s.rho), theta.push_back(s.theta), phi.push_back(s.phi);
  Result result;
  const double start = cpu_seconds();
  meridian.synchronise(phi.data(), phi.size(), w.data());
  celadon::MomentGrid sums(
      {0, 2, kAlong, kAround / 4, 3, 3, celadon::BaseArcs::full_circle(), celadon::BaseKind::sphere});
  sums.add(rho, theta, w);
  const celadon::FitLadder ladder(sums, {0, kAlong, {true, true}}, 3, 3, celadon::JointContinuity::curvature);
  const celadon::NormalEquations equations = ladder.equations(0, 0);
  const auto free = celadon::NormalSolver(equations).solve();
  if (!free) std::exit((std::fprintf(stderr, "sphere_bench: the system could not be solved\n"), 1));
  const celadon::RangeFunction f = range_function(equations, *free);
  result.seconds = cpu_seconds() - start;
  result.coefficients = equations.jets()->unknowns();
  judge(result, check, [&](double p, double t) { return f(t, meridian.v_of_theta(p)); });
  return result;
}

// Bicubic over the strip (theta, phi), which knows neither seam nor poles.
Result alglib_strip(const std::vector<Sample>& samples, const std::vector<Sample>& check) {
  alglib::real_2d_array points;
  points.setlength(static_cast<alglib::ae_int_t>(samples.size()), 3);
  for (std::size_t k = 0; k < samples.size(); ++k) {
    const auto row = static_cast<alglib::ae_int_t>(k);
    points(row, 0) = samples[k].theta, points(row, 1) = samples[k].phi, points(row, 2) = samples[k].rho;
  }
  Result result;
  alglib::spline2dinterpolant spline;
  const double start = cpu_seconds();
  alglib::spline2dbuilder builder;
  alglib::spline2dbuildercreate(1, builder);
  alglib::spline2dbuildersetpoints(builder, points, points.rows());
  alglib::spline2dbuildersetgrid(builder, kAround, kAlong);
  alglib::spline2dbuildersetarea(builder, 0, 2 * kPi, 0, kPi);
  alglib::spline2dbuildersetalgoblocklls(builder, 1e-6);
  alglib::spline2dfitreport report;
  alglib::spline2dfit(builder, spline, report);
  result.seconds = cpu_seconds() - start;
  result.coefficients = kAround * kAlong;
  judge(result, check, [&](double p, double t) { return alglib::spline2dcalc(spline, t, p); });
  return result;
}

void save(const std::string& file, const std::vector<Sample>& samples) {
  std::ofstream(file, std::ios::binary)
      .write(reinterpret_cast<const char*>(samples.data()),
             static_cast<std::streamsize>(samples.size() * sizeof(Sample)));
}

bool fitpack(const std::vector<Sample>& samples, const std::vector<Sample>& check, Result& result) {
  const std::string scipy = CELADON_BIN_DIR "/../scipy", source = CELADON_SOURCE_DIR "/tests/bench/";
  if (std::system((source + "fetch_scipy " + scipy + " >/dev/null 2>&1").c_str()) != 0) return false;
  const celadon::testing::TemporaryFolder folder;
  save(folder / "samples", samples);
  save(folder / "check", check);
  // Interior knots that leave as many coefficients: around they close, along 4 more than intervals.
  const std::string command = scipy + "/python3 " + source + "sphere_peer.py " + (folder / "samples").string() + " " +
                              std::to_string(kAround - 1) + " " + std::to_string(kAlong - 4) + " " +
                              (folder / "check").string();
  std::FILE* out = popen(command.c_str(), "r");
  const bool read = out && std::fscanf(out, "%lf %lf %lf %lf %lf", &result.seconds, &result.coefficients, &result.rms,
                                       &result.largest, &result.tear) == 5;
  return out && pclose(out) == 0 && read;
}

void print(const char* name, const Result& r, double reference_s) {
  std::printf("%-34s %9.1f ms %8.1f x %8.0f %12.2e %12.2e %12.1e\n", name, r.seconds * 1e3, r.seconds / reference_s,
              r.coefficients, r.rms, r.largest, r.tear);
}

}  // namespace

int main(int argc, char** argv) {
  const std::size_t count = argc > 1 ? std::strtoull(argv[1], nullptr, 10) : 100'000;
  const auto samples = samples_of(count, kSigma_mm, 3), check = samples_of(20'000, 0, 4);
  const Result own = ours(samples, check), strip = alglib_strip(samples, check);
  std::printf("%zu samples, noise %.2f mm\n%-34s %12s %10s %8s %12s %12s %12s\n", count, kSigma_mm, "", "time", "",
              "unknowns", "RMS mm", "largest mm", "poles tear");
  print("celadon, poles by 2-jets", own, own.seconds);
  print("ALGLIB BlockLLS on (theta, phi)", strip, own.seconds);
  Result sphere;
  if (!fitpack(samples, check, sphere)) {
    std::printf("NO SCIPY: tests/bench/fetch_scipy failed, FITPACK is not measured\n");
    return 1;
  }
  print("FITPACK LSQSphereBivariateSpline", sphere, own.seconds);
  return 0;
}
