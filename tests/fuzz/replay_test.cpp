// A fuzz target on inputs drawn by seed, with the ordinary tests: runs of bytes, of the same byte, and of small
// numbers, as registers and requests have them. The campaigns: README.md of this folder.

#include <gtest/gtest.h>

#include <cstddef>
#include <cstdint>
#include <random>
#include <vector>

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size);

namespace {

TEST(FuzzReplay, CELADON_REPLAY) {
  std::mt19937 random(20261129);
  for (int input = 0; input < 20'000; ++input) {
    std::vector<std::uint8_t> bytes;
    const std::size_t size = random() % 1'500;
    while (bytes.size() < size) {
      const auto kind = random() % 3;
      const auto same = static_cast<std::uint8_t>(random());
      for (auto run = 1 + random() % 12; run > 0; --run) {
        const auto drawn = static_cast<std::uint8_t>(random());
        bytes.push_back(kind == 0 ? drawn : kind == 1 ? same : static_cast<std::uint8_t>(drawn % 17));
      }
    }
    ASSERT_EQ(LLVMFuzzerTestOneInput(bytes.data(), bytes.size()), 0);
  }
}

}  // namespace
