// Reading ahead changes nothing of what is read: against the stream itself, whenever it is rewound or dropped.

#include "daemon/read_ahead.h"

#include <gtest/gtest.h>

#include <random>

namespace celadon {
namespace {

/// Profiles of growing and shrinking size that name themselves.
class Numbered final : public ProfileStream {
 public:
  explicit Numbered(std::uint32_t count) : count_(count) {}
  void rewind() override {
    at_ = 0;
    ++rewinds;
  }
  const Profile* next() override {
    if (at_ == count_) return nullptr;
    profile_.index = at_;
    profile_.r_mm.assign(1 + at_ % 7, at_);
    profile_.theta_rad.assign(profile_.size(), 0.5 * at_);
    profile_.z_mm.assign(profile_.size(), -1. * at_);
    profile_.covariance.assign(at_ % 2 == 0 ? profile_.size() : 0, {});
    ++at_;
    return &profile_;
  }
  int rewinds = 0;

 private:
  std::uint32_t count_, at_ = 0;
  Profile profile_;
};

void expect_profile(const Profile* p, std::uint32_t index) {
  ASSERT_NE(p, nullptr) << "profile " << index;
  EXPECT_EQ(p->index, index);
  EXPECT_EQ(p->size(), 1 + index % 7);
  EXPECT_EQ(p->r_mm.back(), index);
  EXPECT_EQ(p->theta_rad.back(), 0.5 * index);
  EXPECT_EQ(p->z_mm.back(), -1. * index);
  EXPECT_EQ(p->covariance.size(), index % 2 == 0 ? p->size() : 0);
}

TEST(ReadAhead, GivesTheSameProfilesInTheSameOrder) {
  for (const std::uint32_t count : {0u, 1u, 2u, 1000u}) {
    Numbered source(count);
    ReadAhead ahead(source);
    for (std::uint32_t k = 0; k < count; ++k) expect_profile(ahead.next(), k);
    EXPECT_EQ(ahead.next(), nullptr);
    EXPECT_EQ(ahead.next(), nullptr) << "the end stays the end";
  }
}

TEST(ReadAhead, BeginsAnewWheneverItIsRewound) {
  std::mt19937 random(5);
  Numbered source(200);
  ReadAhead ahead(source);
  for (int round = 0; round < 100; ++round) {
    const std::uint32_t wanted = std::uniform_int_distribution<std::uint32_t>(0, 200)(random);
    for (std::uint32_t k = 0; k < wanted; ++k) expect_profile(ahead.next(), k);
    ahead.rewind();
  }
  for (std::uint32_t k = 0; k < 200; ++k) expect_profile(ahead.next(), k);
  EXPECT_EQ(ahead.next(), nullptr);
  EXPECT_EQ(source.rewinds, 101);
}

TEST(ReadAhead, LeavesTheSourceFreeWhenItIsDropped) {
  Numbered source(500);
  for (int taken : {0, 1, 30}) {
    {
      ReadAhead ahead(source);
      for (int k = 0; k < taken; ++k) expect_profile(ahead.next(), static_cast<std::uint32_t>(k));
    }
    source.rewind();
    for (std::uint32_t k = 0; k < 500; ++k) expect_profile(source.next(), k);
  }
}

}  // namespace
}  // namespace celadon
