// What holds of LaserLineExtractor for pictures that nobody thought of.

#include <gtest/gtest.h>
#include <rapidcheck.h>

#include <cmath>
#include <random>
#include <vector>

#include "acquisition/laser_line.h"
#include "tests/acquisition/extracted_rows.h"
#include "tests/acquisition/synthetic_line.h"

namespace celadon {
namespace {

using synthetic::mode_of;
using Bytes = std::vector<std::uint8_t>;

TEST(LaserLine, AnyBytesGiveFiniteRowsInsideTheFrame) {
  rc::check("finite and inside", [] {
    const int width = *rc::gen::inRange(64, 400), height = *rc::gen::inRange(1, 40);
    const int kind = *rc::gen::inRange(0, 4);
    std::mt19937 random(*rc::gen::arbitrary<unsigned>());
    Bytes on(static_cast<std::size_t>(width * height)), off(on.size());
    for (auto* frame : {&on, &off}) {
      for (auto& value : *frame) {
        const auto r = static_cast<unsigned>(random());
        value = static_cast<std::uint8_t>(kind == 0   ? r & 255
                                          : kind == 1 ? (r % 50 == 0 ? 255 : 0)
                                          : kind == 2 ? (r & 1) * 255
                                                      : (r % 400 == 0 ? 255 : 250));
      }
    }
    LaserLineOptions options;
    options.minimum_contrast = 1;
    options.ambiguous_percent = 100;
    options.speckle_contrast = *rc::gen::element(0.f, 0.2f, 1.f);
    options.refinement = *rc::gen::element(LineRefinement::zero_crossing, LineRefinement::quasi_maximum_likelihood);
    for (const bool subtract : {false, true}) {
      const auto rows =
          extract(mode_of(width, height), on,
                  subtract ? std::span<const std::uint8_t>(off) : std::span<const std::uint8_t>(), options);
      for (const LineRow& row : rows) {
        const bool found = row.status == RowStatus::found || row.status == RowStatus::saturated;
        RC_ASSERT(found == (row.x_px >= 0));
        RC_ASSERT(row.x_px == -1 || (row.x_px >= 0 && row.x_px <= static_cast<float>(width - 1)));
        RC_ASSERT(std::isfinite(row.sigma_px) && std::isfinite(row.amplitude) && std::isfinite(row.width_px));
        RC_ASSERT(!found || (row.sigma_px > 0 && row.width_px > 0 && row.amplitude > 0));
      }
    }
  });
}

TEST(LaserLine, ShiftingThePictureShiftsTheLine) {
  rc::check("shift by whole cells", [] {
    const double start = *rc::gen::inRange(1500, 2500) / 10.0, width = *rc::gen::inRange(10, 45) / 10.0;
    const int shift = 4 * *rc::gen::inRange(1, 20);
    auto scene = synthetic::nominal_scene();
    const auto picture = synthetic::straight_line(480, 24, start, 0.2, width, scene, *rc::gen::arbitrary<unsigned>());
    Bytes moved(picture.on.size());
    for (std::size_t i = 0; i < moved.size(); ++i) {
      const int x = static_cast<int>(i % 480) - shift;
      moved[i] = picture.on[i - i % 480 + static_cast<std::size_t>((x + 480) % 480)];
    }
    const auto before = extract(mode_of(480, 24), picture.on), after = extract(mode_of(480, 24), moved);
    for (std::size_t y = 0; y < before.size(); ++y) {
      RC_ASSERT(before[y].status == after[y].status);
      if (before[y].x_px >= 0) RC_ASSERT(std::abs(before[y].x_px + static_cast<float>(shift) - after[y].x_px) < 1e-4f);
    }
  });
}

}  // namespace
}  // namespace celadon
