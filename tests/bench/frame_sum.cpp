#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "tests/bench/frame_sum.cpp"
#include "hwy/foreach_target.h"
#include "hwy/highway.h"

#include "tests/bench/frame_sum.h"

HWY_BEFORE_NAMESPACE();
namespace celadon::bench {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

std::uint64_t sum(const std::uint8_t* bytes, std::size_t count) {
  const hn::ScalableTag<std::uint8_t> d;
  const hn::Repartition<std::uint64_t, decltype(d)> d64;
  const std::size_t lanes = hn::Lanes(d);
  auto a = hn::Zero(d64), b = a, c = a, e = a;
  std::size_t i = 0;
  for (; i + 4 * lanes <= count; i += 4 * lanes) {
    a = hn::Add(a, hn::SumsOf8(hn::LoadU(d, bytes + i)));
    b = hn::Add(b, hn::SumsOf8(hn::LoadU(d, bytes + i + lanes)));
    c = hn::Add(c, hn::SumsOf8(hn::LoadU(d, bytes + i + 2 * lanes)));
    e = hn::Add(e, hn::SumsOf8(hn::LoadU(d, bytes + i + 3 * lanes)));
  }
  std::uint64_t total = hn::GetLane(hn::SumOfLanes(d64, hn::Add(hn::Add(a, b), hn::Add(c, e))));
  for (; i < count; ++i) total += bytes[i];
  return total;
}

}  // namespace HWY_NAMESPACE
}  // namespace celadon::bench
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace celadon::bench {

HWY_EXPORT(sum);
std::uint64_t sum_of_bytes(const std::uint8_t* bytes, std::size_t count) {
  return HWY_DYNAMIC_DISPATCH(sum)(bytes, count);
}

}  // namespace celadon::bench
#endif
