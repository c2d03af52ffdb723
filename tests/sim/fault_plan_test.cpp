#include "sim/fault_plan.h"

#include <gtest/gtest.h>

namespace celadon::sim {
namespace {

TEST(FaultPlan, NamesAndArgumentsAreChecked) {
  EXPECT_TRUE(make_fault("drop-frame", {}));
  const std::vector<std::string> three{"3"}, two{"1", "2"}, bad{"x"}, big{"1e99"}, nan{"nan"}, empty{""};
  EXPECT_EQ(make_fault("drop-frame", three)->value, 3);
  for (const auto& arguments : {two, bad, big, nan, empty}) EXPECT_FALSE(make_fault("drop-frame", arguments));
  EXPECT_FALSE(make_fault("interlock-open", three));
  EXPECT_FALSE(make_fault("no-such-fault", {}));
  EXPECT_NE(make_fault("drop-frame", bad).error().find("\"x\""), std::string::npos);
}

TEST(FaultPlan, OptionsCarryArgumentAndTime) {
  const auto order = parse_fault_option("encoder-slip,2.5@12.5", 1'000);
  ASSERT_TRUE(order);
  EXPECT_EQ(order->value, 2.5);
  EXPECT_EQ(order->at_ns, 12'500'001'000);
  EXPECT_FALSE(parse_fault_option("encoder-slip@-1", 0));
  EXPECT_FALSE(parse_fault_option("encoder-slip@soon", 0));
  EXPECT_TRUE(parse_fault_option("interlock-open", 0));
}

TEST(FaultPlan, CountedFaultsRunOut) {
  FaultPlan plan;
  const std::vector<std::string> two{"2"}, zero{"0"};
  plan.arm(*make_fault("corrupt-frame", two));
  EXPECT_TRUE(plan.strikes("corrupt-frame"));
  EXPECT_TRUE(plan.strikes("corrupt-frame"));
  EXPECT_FALSE(plan.strikes("corrupt-frame"));
  plan.arm(*make_fault("modbus-silent", zero));
  for (int i = 0; i < 100; ++i) EXPECT_TRUE(plan.strikes("modbus-silent"));
  plan.clear("modbus-silent");
  EXPECT_FALSE(plan.strikes("modbus-silent"));
}

TEST(FaultPlan, ScheduledOrdersComeOnceAndInTime) {
  FaultPlan plan;
  plan.schedule(*parse_fault_option("interlock-open@2", 0));
  plan.schedule(*parse_fault_option("laser-dead@1", 0));
  EXPECT_EQ(plan.next_ns(), 1'000'000'000);
  EXPECT_TRUE(plan.due(999'999'999).empty());
  EXPECT_EQ(plan.due(1'000'000'000).size(), 1U);
  EXPECT_EQ(plan.due(5'000'000'000).size(), 1U);
  EXPECT_EQ(plan.next_ns(), INT64_MAX);
}

}  // namespace
}  // namespace celadon::sim
