// What a fit costs over the number of points and over the number of control points, up to 512 x 512: seconds and
// memory. Writes linear_cost.csv into the folder given (default: the current one); fitting/figures/linear_cost.gnuplot
// draws it.
#include <sys/resource.h>

#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <optional>
#include <random>
#include <string>
#include <vector>

#include "fitting/normal_solver.h"
#include "fitting/nurbs_surface.h"
#include "tests/fitting/fit_tools.h"

namespace {

using Clock = std::chrono::steady_clock;
using celadon::MomentGrid;
using celadon::test::kPi;

double seconds_since(Clock::time_point start) {
  return std::chrono::duration<double>(Clock::now() - start).count();
}

double peak_mb() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return static_cast<double>(usage.ru_maxrss) / 1024;
}

// Sums of n scattered points, made in pieces that are not kept; the seconds that adding them took.
double add_points(MomentGrid& sums, std::size_t n) {
  constexpr std::size_t kPiece = 1 << 16;
  std::mt19937_64 random(5);
  std::normal_distribution<double> normal(0, 0.02);
  std::uniform_real_distribution<double> share(0, 1);
  std::vector<double> r(kPiece), theta(kPiece), z(kPiece);
  double seconds = 0;
  for (std::size_t done = 0; done < n; done += kPiece) {
    const std::size_t piece = std::min(kPiece, n - done);
    for (std::size_t k = 0; k < piece; ++k) {
      theta[k] = 2 * kPi * share(random);
      z[k] = 120 * share(random);
      r[k] = celadon::test::freeform(theta[k], z[k]) + normal(random);
    }
    const auto start = Clock::now();
    sums.add(std::span(r).first(piece), std::span(theta).first(piece), std::span(z).first(piece));
    seconds += seconds_since(start);
  }
  return seconds;
}

struct Cost {
  double accumulate_s = 0, solve_s = 0, rms_mm = 0;
  int around = 0, along = 0;
};

Cost cost_of(std::size_t points, int intervals) {
  MomentGrid sums(
      {0, 120, intervals, intervals / 4, 3, 3, celadon::BaseArcs::full_circle(), celadon::BaseKind::cylinder});
  Cost cost;
  cost.accumulate_s = add_points(sums, points);
  const auto start = Clock::now();
  const celadon::NormalEquations equations(sums,
                                           {celadon::RangeSpace::open(3, celadon::test::even_breaks(0, 120, intervals)),
                                            celadon::RangeSpace::over(3, sums.arcs(), intervals / 4)});
  const auto free = celadon::NormalSolver(equations).solve();
  if (!free) {
    std::fprintf(stderr, "linear_cost: %zu points do not determine %d x %d control points\n", points, intervals,
                 intervals);
    std::exit(1);
  }
  const celadon::RangeFunction f = range_function(equations, *free);
  const celadon::NurbsSurface surface = symbolic_product(f);
  cost.solve_s = seconds_since(start);
  cost.along = static_cast<int>(free->rows());
  cost.around = static_cast<int>(free->cols());
  cost.rms_mm = celadon::test::miss(f, celadon::test::freeform).rms;
  return cost;
}

}  // namespace

int main(int argc, char** argv) {
  const std::string path = std::string(argc > 1 ? argv[1] : ".") + "/linear_cost.csv";
  std::FILE* file = std::fopen(path.c_str(), "w");
  if (!file) {
    std::fprintf(stderr, "linear_cost: %s cannot be written\n", path.c_str());
    return 2;
  }
  std::fputs("over,points,unknowns,accumulate_s,solve_s,peak_mb\n", file);
  std::puts(
      "     points   unknowns  accumulate        a point   sums to surface   an unknown   peak memory   RMS to truth");
  const auto row = [&](const char* over, std::size_t points, int intervals) {
    const Cost c = cost_of(points, intervals);
    const double unknowns = static_cast<double>(c.along) * c.around;
    std::printf("%11zu  %4d x %3d  %8.3f s  %8.2f ns  %12.2f ms  %8.2f us  %8.0f MB  %10.2e mm\n", points, c.along,
                c.around, c.accumulate_s, c.accumulate_s / static_cast<double>(points) * 1e9, c.solve_s * 1e3,
                c.solve_s / unknowns * 1e6, peak_mb(), c.rms_mm);
    std::fprintf(file, "%s,%zu,%.0f,%.6g,%.6g,%.1f\n", over, points, unknowns, c.accumulate_s, c.solve_s, peak_mb());
  };
  for (const std::size_t points : {100'000UL, 300'000UL, 1'000'000UL, 3'000'000UL, 10'000'000UL, 30'000'000UL})
    row("points", points, 64);
  for (const int intervals : {16, 32, 64, 128, 256, 512}) row("unknowns", 8'000'000, intervals);
  std::fclose(file);
  return 0;
}
