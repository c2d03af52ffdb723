#include "daemon/lease_history.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <random>
#include <vector>

namespace celadon {
namespace {

using Light = LeaseHistory::Light;

TEST(LeaseHistory, IsSureOfTheLaserWithinALeaseOnly) {
  LeaseHistory leases;
  EXPECT_EQ(leases.between(0, 1), Light::not_sure);
  leases.grant(100, 103, 500);
  EXPECT_EQ(leases.between(103, 600), Light::on);
  EXPECT_EQ(leases.between(102, 600), Light::not_sure) << "the request was on its way";
  EXPECT_EQ(leases.between(103, 601), Light::not_sure) << "the lease may count from the request's begin";
  leases.grant(400, 401, 500);  // in time
  EXPECT_EQ(leases.shining_since_ns(), 103);
  EXPECT_EQ(leases.between(103, 900), Light::on);
  leases.grant(1000, 1002, 500);  // too late
  EXPECT_EQ(leases.shining_since_ns(), 1002);
  EXPECT_EQ(leases.between(880, 1010), Light::not_sure);
  EXPECT_EQ(leases.between(200, 880), Light::on) << "a frame that waited in the driver's buffers";
  leases.end(1100);
  EXPECT_EQ(leases.between(1010, 1100), Light::on);
  EXPECT_EQ(leases.between(1010, 1101), Light::not_sure);
}

TEST(LeaseHistory, ALaserThatWentOnWarmsUp) {
  LeaseHistory leases;
  leases.grant(0, 1, 500);
  leases.set_warm_up(50);
  EXPECT_EQ(leases.between(50, 60), Light::warming_up);
  EXPECT_EQ(leases.between(51, 60), Light::on);
}

// Against a laser that is told to be on instant by instant.
TEST(LeaseHistory, NeverClaimsLightThatMayNotHaveBeen) {
  std::mt19937 random(11);
  for (int trial = 0; trial < 200; ++trial) {
    constexpr int kEnd = 4000;
    std::vector<bool> sure(kEnd, false);
    LeaseHistory leases;
    for (int t = 10; t < kEnd - 300;) {
      const int taken = std::uniform_int_distribution(0, 30)(random), lease = 100;
      leases.grant(t, t + taken, lease);
      for (int k = t + taken; k <= t + lease; ++k) sure[static_cast<std::size_t>(k)] = true;
      if (random() % 5 == 0) {
        const int off = t + taken + std::uniform_int_distribution(0, 60)(random);
        leases.end(off);
        for (int k = off + 1; k < kEnd; ++k) sure[static_cast<std::size_t>(k)] = false;
        t = off;
      }
      t += taken + std::uniform_int_distribution(1, 160)(random);
    }
    for (int k = 0; k < 300; ++k) {
      const int begin = std::uniform_int_distribution(0, kEnd - 200)(random);
      const int end = begin + std::uniform_int_distribution(1, 150)(random);
      if (leases.between(begin, end) != Light::on) continue;
      EXPECT_TRUE(std::all_of(sure.begin() + begin, sure.begin() + end, [](bool on) { return on; }));
    }
  }
}

}  // namespace
}  // namespace celadon
