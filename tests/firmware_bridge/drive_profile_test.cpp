// Counts and quantities of foreign registers: words against bytes written by hand, units against their definitions.

#include "firmware_bridge/drive_profile.h"

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <array>
#include <cmath>

namespace celadon {
namespace {

DriveRegister any_register() {
  DriveRegister r;
  r.words = *rc::gen::inRange(1, 3);
  r.is_signed = *rc::gen::arbitrary<bool>();
  return r;
}

std::int64_t any_count(const DriveRegister& r) {
  const std::int64_t span = std::int64_t{1} << (16 * r.words);
  return *rc::gen::inRange<std::int64_t>(0, span) - (r.is_signed ? span / 2 : 0);
}

// The value of the words as the manuals put it: two's complement of the halves in their order.
std::int64_t by_hand(const DriveRegister& r, WordOrder order, const std::array<std::uint16_t, 2>& words) {
  std::int64_t value = words[0];
  if (r.words == 2)
    value = order == WordOrder::high_first ? words[0] * std::int64_t{65536} + words[1]
                                           : words[1] * std::int64_t{65536} + words[0];
  const std::int64_t span = r.words == 2 ? std::int64_t{1} << 32 : 65536;
  return r.is_signed && value >= span / 2 ? value - span : value;
}

RC_GTEST_PROP(DriveProfile, words_are_read_and_written_as_the_manual_says, ()) {
  const DriveRegister r = any_register();
  const WordOrder order = *rc::gen::element(WordOrder::high_first, WordOrder::low_first);
  std::array<std::uint16_t, 2> words = {*rc::gen::arbitrary<std::uint16_t>(), *rc::gen::arbitrary<std::uint16_t>()};
  RC_ASSERT(get_count(r, order, words) == by_hand(r, order, words));
  const std::int64_t count = any_count(r);
  RC_ASSERT(in_range(r, count));
  put_count(r, order, count, words);
  RC_ASSERT(by_hand(r, order, words) == count);
}

TEST(DriveProfile, WhatARegisterCannotHoldIsOutOfRange) {
  DriveRegister r;
  for (const auto& [words, is_signed, lowest, highest] :
       {std::tuple{1, false, std::int64_t{0}, std::int64_t{65535}},
        {1, true, std::int64_t{-32768}, std::int64_t{32767}},
        {2, false, std::int64_t{0}, std::int64_t{4294967295}},
        {2, true, std::int64_t{-2147483648}, std::int64_t{2147483647}}}) {
    r.words = words;
    r.is_signed = is_signed;
    EXPECT_TRUE(in_range(r, lowest) && in_range(r, highest));
    EXPECT_FALSE(in_range(r, lowest - 1) || in_range(r, highest + 1));
  }
}

RC_GTEST_PROP(DriveProfile, a_quantity_comes_back_within_half_a_count, ()) {
  DriveRegister r = any_register();
  r.words = 2;
  r.is_signed = true;
  r.unit = *rc::gen::element(DriveUnit::step, DriveUnit::step_per_s, DriveUnit::rpm, DriveUnit::ms);
  r.scale = *rc::gen::element(0.01, 0.1, 1.0, 100.0);
  const double steps_per_turn = *rc::gen::inRange(200, 51200);
  const double quantity = *rc::gen::inRange(1, 1'000'000) + 0.25;
  const auto count = count_of(r, quantity, steps_per_turn);
  RC_ASSERT(count.has_value());
  const double one = r.unit == DriveUnit::rpm ? r.scale * steps_per_turn / 60 : r.scale;
  const bool is_rate = r.unit == DriveUnit::step_per_s || r.unit == DriveUnit::rpm;
  if (is_rate && quantity < one) {
    RC_ASSERT(*count == 1);  // the slowest that moves
  } else {
    RC_ASSERT(std::abs(quantity_of(r, *count, steps_per_turn) - quantity) <= 0.5 * one * (1 + 1e-9));
  }
}

RC_GTEST_PROP(DriveProfile, accelerations_are_never_faster_than_asked_for, ()) {
  DriveRegister r;
  r.words = 2;
  r.unit = *rc::gen::element(DriveUnit::step_per_s2, DriveUnit::ms_per_1000rpm);
  const double steps_per_turn = *rc::gen::inRange(200, 51200);
  const double wanted = *rc::gen::inRange(1000, 10'000'000);
  const auto count = count_of(r, wanted, steps_per_turn);
  RC_ASSERT(count.has_value());
  const double got = quantity_of(r, *count, steps_per_turn);
  RC_ASSERT(got <= wanted * (1 + 1e-8));
  // One count the other way would be too fast, or there is none.
  const std::int64_t faster = r.unit == DriveUnit::step_per_s2 ? *count + 1 : *count - 1;
  RC_ASSERT(faster == 0 || quantity_of(r, faster, steps_per_turn) > wanted);
}

TEST(DriveProfile, UnitsByTheirDefinition) {
  DriveRegister r;
  r.words = 2;
  r.unit = DriveUnit::rpm;
  EXPECT_DOUBLE_EQ(quantity_of(r, 60, 10000), 10000);  // a turn a second
  r.unit = DriveUnit::ms_per_1000rpm;
  EXPECT_DOUBLE_EQ(quantity_of(r, 1000, 6000), 100'000);  // 1000 rpm are 100000 steps/s, gained in a second
  EXPECT_EQ(count_of(r, 100'000, 6000), 1000);
  EXPECT_EQ(quantity_of(r, 0, 6000), 0);
  r.unit = DriveUnit::ms;
  r.scale = 100;
  EXPECT_DOUBLE_EQ(quantity_of(r, 5, 1), 500);
  r.words = 1;
  r.unit = DriveUnit::step;
  r.scale = 1;
  EXPECT_EQ(count_of(r, 70'000, 1), std::nullopt);
  EXPECT_EQ(count_of(r, -1, 1), std::nullopt);
  EXPECT_EQ(count_of(r, std::nan(""), 1), std::nullopt);
}

// Every register is in exactly one block, which begins and ends with one and has no gap.
RC_GTEST_PROP(DriveProfile, blocks_cover_what_is_wanted_without_gaps, ()) {
  std::vector<DriveRegister> registers;
  std::vector<std::size_t> wanted;
  const int count = *rc::gen::inRange(1, 20);
  for (int i = 0; i < count; ++i) {
    DriveRegister r = any_register();
    r.address = *rc::gen::inRange<std::uint16_t>(0, 40);
    r.area = *rc::gen::element(protocol::Area::input, protocol::Area::holding);
    registers.push_back(r);
    wanted.push_back(static_cast<std::size_t>(i));
  }
  std::vector<int> seen(registers.size());
  for (const RegisterBlock& block : blocks_of(registers, wanted)) {
    std::vector<bool> covered(block.words);
    for (const std::size_t i : block.registers) {
      const DriveRegister& r = registers[i];
      ++seen[i];
      RC_ASSERT(r.area == block.area);
      RC_ASSERT(r.address >= block.address);
      RC_ASSERT(r.address + r.words <= block.address + block.words);
      for (int w = 0; w < r.words; ++w) covered[static_cast<std::size_t>(r.address - block.address + w)] = true;
    }
    for (const bool word : covered) RC_ASSERT(word);
  }
  for (const int times : seen) RC_ASSERT(times == 1);
}

}  // namespace
}  // namespace celadon
