#include "acquisition/datum/tag_picture.h"

#include <apriltag/apriltag.h>
#include <apriltag/tag36h11.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdlib>
#include <memory>

namespace celadon {
namespace {

/// Cells of a tag with its border, 10 x 10; 1 is white.
std::vector<float> cells_of(int number) {
  const std::unique_ptr<apriltag_family_t, void (*)(apriltag_family_t*)> family{tag36h11_create(), tag36h11_destroy};
  // The library exports nothing that frees its pictures: two blocks of malloc's.
  image_u8_t* const image = apriltag_to_image(family.get(), number);
  std::vector<float> cells;
  for (int y = 0; y < 10; ++y) {
    for (int x = 0; x < 10; ++x) cells.push_back(image->buf[y * image->stride + x] > 127 ? 1.f : 0.f);
  }
  std::free(image->buf);
  std::free(image);
  return cells;
}

}  // namespace

TagPicture::TagPicture(int number) : levels_(static_cast<std::size_t>(kSide) * kSide) {
  const std::vector<float> cells = cells_of(number);
  const auto cell = [&](int x, int y) {
    const int i = std::clamp(x, 0, kSide - 1) / kPerCell, j = std::clamp(y, 0, kSide - 1) / kPerCell;
    return cells[static_cast<std::size_t>(10 * j + i)];
  };
  constexpr int kReach = kPerCell / 8;
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      float sum = 0;
      for (int dy = -kReach; dy <= kReach; ++dy) {
        for (int dx = -kReach; dx <= kReach; ++dx) sum += cell(x + dx, y + dy);
      }
      levels_[static_cast<std::size_t>(kSide * y + x)] = sum / static_cast<float>((2 * kReach + 1) * (2 * kReach + 1));
    }
  }
}

double TagPicture::white(double x, double y) const {
  const auto place = [](double c) { return std::clamp((c + kBorder) / kCell * kPerCell - 0.5, 0., kSide - 1.001); };
  const double px = place(x), py = place(y);
  const auto i = static_cast<std::size_t>(px), j = static_cast<std::size_t>(py);
  const double fx = px - static_cast<double>(i), fy = py - static_cast<double>(j);
  const float* const at = levels_.data() + kSide * j + i;
  return (1 - fy) * ((1 - fx) * static_cast<double>(at[0]) + fx * static_cast<double>(at[1])) +
         fy * ((1 - fx) * static_cast<double>(at[kSide]) + fx * static_cast<double>(at[kSide + 1]));
}

}  // namespace celadon
