// Whole calibrations by machines that do more than the model holds (bowed prints and sheets, a lens that no polynomial
// follows, spindle and encoder errors, biased extraction, warming), then scans with them: are the stated sizes of a
// cylinder, a taper and a sphere as sure as stated? Arguments: number of seeds (200), first seed (1), factor on all
// that is beyond the model (1). Exits with 1 if a bound does not hold.
#include "tests/integration/stated_lengths.h"

#include <cstdlib>
#include <utility>

int main(int argc, char** argv) {
  using namespace celadon;
  const int seeds = argc > 1 ? std::atoi(argv[1]) : 200;
  const int first = argc > 2 ? std::atoi(argv[2]) : 1;
  const double factor = argc > 3 ? std::atof(argv[3]) : 1;
  const std::string only = argc > 4 ? argv[4] : "";
  test::BeyondSizes sizes;
  const std::vector<std::pair<const char*, double*>> effects = {
      {"bow", &sizes.bow_mm},          {"print", &sizes.print_mm},     {"ripple", &sizes.ripple_px},
      {"sheet", &sizes.sheet_bow_mm},  {"spindle", &sizes.spindle_mm}, {"wobble", &sizes.wobble_rad},
      {"encoder", &sizes.encoder_rad}, {"line", &sizes.line_bias_px},  {"corner", &sizes.corner_bias_px},
      {"warming", &sizes.warming_rad}};
  for (const auto& [name, size] : effects) *size *= only.empty() || only == name ? factor : 0;
  test::StatedLengths lengths(sizes);
  for (int seed = first; seed < first + seeds; ++seed) {
    const std::string error = lengths.add(static_cast<std::uint64_t>(seed));
    if (!error.empty()) {
      std::printf("seed %d: %s\n", seed, error.c_str());
      return 1;
    }
  }
  std::printf(
      "%d seeds from %d on, factor %g, %d calibrations refused, residuals %.3f times what their noise explains\n\n",
      seeds, first, factor, lengths.refused(), lengths.mean_inflation());
  std::printf("| size | rms error | mean stated u | U / 2 rms | covered by k = 2 |\n|---|---|---|---|---|\n");
  for (const test::StatedSize& size : lengths.sizes()) {
    std::printf("| %s | %.3g %s | %.3g %s | %.2f | %.1f %% |\n", size.name.c_str(), size.rms(), size.unit.c_str(),
                size.mean_u(), size.unit.c_str(), size.mean_u() / size.rms(), 100 * size.coverage());
  }
  const bool covers = lengths.pooled_coverage() >= 0.92 && lengths.pooled_coverage() <= 0.98;
  const bool tight = lengths.pooled_excess() <= 1.5;
  std::printf(
      "\nall together: covered %.1f %% (92 to 98: %s), U / 2 rms %.2f (at most 1.5: %s); the same sphere at two places "
      "within U: %.1f %%\n",
      100 * lengths.pooled_coverage(), covers ? "holds" : "FAILS", lengths.pooled_excess(), tight ? "holds" : "FAILS",
      100 * lengths.agreement());
  return covers && tight ? 0 : 1;
}
