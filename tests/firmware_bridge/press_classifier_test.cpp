// Presses as a plan has them, against what the classifier makes of their bouncing edges.

#include "firmware_bridge/press_classifier.h"

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <vector>

namespace celadon {
namespace {

constexpr std::int64_t kMs = 1'000'000;
constexpr PressTiming kTiming{20 * kMs, 2'000 * kMs};

std::vector<PressLength> all_of(PressClassifier& presses) {
  std::vector<PressLength> taken;
  while (const auto length = presses.take()) taken.push_back(*length);
  return taken;
}

TEST(PressClassifier, APressIsToldOnceItsLengthIsKnown) {
  PressClassifier presses(kTiming);
  presses.resume(false, 0);
  presses.edge(true, 100 * kMs);
  presses.advance(2'099 * kMs);
  EXPECT_FALSE(presses.take());
  presses.advance(2'100 * kMs);
  EXPECT_EQ(presses.take(), PressLength::lasting) << "while it is still down";
  presses.edge(false, 9'000 * kMs);
  presses.edge(true, 9'100 * kMs);
  presses.edge(false, 9'300 * kMs);
  presses.advance(9'319 * kMs);
  EXPECT_FALSE(presses.take());
  presses.advance(9'320 * kMs);
  EXPECT_EQ(presses.take(), PressLength::brief);
  EXPECT_FALSE(presses.take());
}

TEST(PressClassifier, AContactThatIsDownWhenItComesIntoSightIsNoPress) {
  PressClassifier presses(kTiming);
  presses.resume(true, 0);
  presses.advance(60'000 * kMs);
  presses.edge(false, 60'000 * kMs);
  presses.advance(70'000 * kMs);
  EXPECT_FALSE(presses.use_begun());
  EXPECT_FALSE(presses.take());
}

TEST(PressClassifier, WhatBeganSinceTheMarkIsUsedUpAndNothingElse) {
  PressClassifier presses(kTiming);
  presses.resume(false, 0);
  presses.edge(true, 100 * kMs);
  presses.advance(150 * kMs);
  presses.mark();
  EXPECT_FALSE(presses.use_begun()) << "it began before";
  presses.edge(false, 200 * kMs);
  presses.edge(true, 300 * kMs);
  presses.advance(330 * kMs);
  EXPECT_TRUE(presses.use_begun());
  EXPECT_FALSE(presses.use_begun());
  presses.edge(false, 5'000 * kMs);
  presses.advance(6'000 * kMs);
  EXPECT_EQ(all_of(presses), std::vector{PressLength::brief}) << "the one from before the mark";
}

TEST(PressClassifier, APressThatWasLostFromSightStillStops) {
  PressClassifier presses(kTiming);
  presses.resume(false, 0);
  presses.mark();
  presses.edge(true, 100 * kMs);
  presses.advance(150 * kMs);
  presses.resume(true, 160 * kMs);
  EXPECT_TRUE(presses.use_begun());
  EXPECT_FALSE(presses.take());
}

/// A contact that bounces: its edges, the settled presses, and instants far from all edges.
struct Plan {
  struct Edge {
    bool down;
    std::int64_t time_ns;
  };
  struct Quiet {
    std::int64_t time_ns;
    bool down;
  };
  std::vector<Edge> edges;
  std::vector<std::int64_t> began_ns, ended_ns;
  std::vector<Quiet> quiet;  // before each press, in it
  std::int64_t end_ns = 0;
};

Plan draw_plan() {
  const auto ms = [](int low, int high) { return *rc::gen::inRange(low, high + 1) * kMs; };
  Plan plan;
  std::int64_t now = 0;
  const auto settle = [&](bool down) {
    for (int bounces = *rc::gen::inRange(0, 4); bounces > 0; --bounces) {
      plan.edges.push_back({down, now});
      now += ms(1, 19);
      plan.edges.push_back({!down, now});
      now += ms(1, 19);
    }
    plan.edges.push_back({down, now});
  };
  const auto stay = [&](bool down, std::int64_t half_ns) {
    now += half_ns;
    plan.quiet.push_back({now, down});
    now += half_ns;
    if (*rc::gen::inRange(0, 3) == 0) {  // too short to mean anything
      plan.edges.push_back({!down, now});
      now += ms(1, 19);
      plan.edges.push_back({down, now});
      now += ms(25, 60);
    }
  };
  for (int presses = *rc::gen::inRange(1, 8); presses > 0; --presses) {
    stay(false, ms(30, 700));
    settle(true);
    plan.began_ns.push_back(now);
    const int kind = *rc::gen::inRange(0, 3);
    stay(true, kind == 0 ? ms(30, 300) : kind == 1 ? ms(900, 1'050) : ms(1'500, 3'000));
    settle(false);
    plan.ended_ns.push_back(now);
  }
  plan.end_ns = now + 30 * kMs;
  return plan;
}

RC_GTEST_PROP(PressClassifier, NoPressIsLostOrDoubledAcrossChatterAndDepartures, ()) {
  const Plan plan = draw_plan();
  // At some quiet instants the contact goes out of sight, or comes back.
  std::vector<bool> turns;
  for (std::size_t i = 0; i < plan.quiet.size(); ++i) turns.push_back(*rc::gen::inRange(0, 4) == 0);

  std::vector<PressLength> expected;
  bool seen = true;
  for (std::size_t press = 0; press < plan.began_ns.size(); ++press) {
    const std::int64_t began = plan.began_ns[press], ended = plan.ended_ns[press];
    if (turns[2 * press]) seen = !seen;
    const bool seen_at_its_begin = seen;
    if (turns[2 * press + 1]) seen = !seen;
    if (!seen_at_its_begin) continue;
    const std::int64_t watched_to = turns[2 * press + 1] ? plan.quiet[2 * press + 1].time_ns : ended;
    if (watched_to - began >= kTiming.lasting_ns) {
      expected.push_back(PressLength::lasting);
    } else if (watched_to == ended) {
      expected.push_back(PressLength::brief);
    }
  }

  PressClassifier presses(kTiming);
  presses.resume(false, 0);
  std::vector<PressLength> taken;
  seen = true;
  std::size_t edge = 0, quiet = 0;
  for (std::int64_t now = 0; now < plan.end_ns; now += *rc::gen::inRange(1, 40) * kMs) {
    for (;;) {
      const bool edge_next = edge < plan.edges.size() && plan.edges[edge].time_ns <= now;
      const bool quiet_next = quiet < plan.quiet.size() && plan.quiet[quiet].time_ns <= now;
      if (!edge_next && !quiet_next) break;
      if (edge_next && (!quiet_next || plan.edges[edge].time_ns < plan.quiet[quiet].time_ns)) {
        if (seen) presses.edge(plan.edges[edge].down, plan.edges[edge].time_ns);
        ++edge;
        continue;
      }
      const Plan::Quiet at = plan.quiet[quiet];
      if (turns[quiet]) {
        seen = !seen;
        presses.advance(at.time_ns);
        if (seen) presses.resume(at.down, at.time_ns);
        if (!seen) presses.resume(true, at.time_ns);
      }
      ++quiet;
    }
    if (seen) presses.advance(now);
    if (*rc::gen::arbitrary<bool>()) {
      for (const PressLength length : all_of(presses)) taken.push_back(length);
    }
  }
  for (; edge < plan.edges.size(); ++edge) {
    if (seen) presses.edge(plan.edges[edge].down, plan.edges[edge].time_ns);
  }
  if (seen) presses.advance(plan.end_ns + 1'000 * kMs);
  for (const PressLength length : all_of(presses)) taken.push_back(length);
  RC_ASSERT(taken == expected);
}

}  // namespace
}  // namespace celadon
