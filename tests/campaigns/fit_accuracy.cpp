// How near the fit comes to the best member of the ladder on the same samples, with white and with correlated noise:
// RMS to truth over the least RMS that any member reaches; exit code 1 above 1.15. Beside it sigma sqrt(kappa P/N) with
// the best member's P. Usage: fit_accuracy [largest number of samples = 1000000]
#include <cstdio>
#include <cstdlib>

#include "fitting/knot_selection.h"
#include "tests/fitting/fit_tools.h"

int main(int argc, char** argv) {
  using namespace celadon;
  constexpr double kSigma = 0.02, kBar = 1.15;
  const double most = argc > 1 ? std::atof(argv[1]) : 1e6;
  bool good = true;
  std::printf("%9s %6s %12s %12s %7s %22s\n", "samples", "AR", "RMS [mm]", "best [mm]", "ratio",
              "sigma sqrt(kappa P/N)");
  for (const int side : {100, 316, 1000})
    for (const double correlation : {0.0, 0.5}) {
      const double n = static_cast<double>(side) * side;
      if (n > most) continue;
      test::MemoryStream stream = test::scan(
          test::freeform, {.profiles = side, .rows = side, .sigma = kSigma, .correlation = correlation, .seed = 7});
      const auto fit = test::fit(stream);
      const auto grid = choose_grid(stream, {});
      if (!fit || !grid) {
        std::printf("%9.0f: no fit\n", n);
        return 1;
      }
      const MomentGrid sums = test::accumulate(stream, *grid);
      const FitLadder ladder(sums, {0, sums.z_cells()}, 3, 3, JointContinuity::curvature);
      double best = 1e300, parameters = 0;
      for (int u = 0; u < ladder.levels_u(); ++u)
        for (int v = 0; v < ladder.levels_v(); ++v)
          if (const auto member = solve_member(ladder, {u, v}, {})) {
            const double rms = test::miss(range_function(*member->equations, member->free), test::freeform).rms;
            if (rms < best) best = rms, parameters = member->parameters;
          }
      const double rms = test::miss(fit->function, test::freeform).rms;
      const double kappa = (1 + correlation) / (1 - correlation);
      std::printf("%9.0f %6.1f %12.3e %12.3e %7.3f %22.3e%s\n", n, correlation, rms, best, rms / best,
                  kSigma * std::sqrt(kappa * parameters / n), rms > kBar * best ? "  OVER" : "");
      good = good && rms <= kBar * best;
    }
  return good ? 0 : 1;
}
