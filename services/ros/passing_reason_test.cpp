#include "ros/passing_reason.hpp"

#include <gtest/gtest.h>

namespace zloam::ros {
namespace {

TEST(PassingReason, PassesAfterAWhileOrWithTheNextRequest) {
  PassingReason reason;
  EXPECT_EQ(reason.shown(1), "");
  reason.say("wrong frame", 100);
  EXPECT_EQ(reason.shown(100 + PassingReason::kShown_ns), "wrong frame");
  EXPECT_EQ(reason.shown(101 + PassingReason::kShown_ns), "");
  EXPECT_EQ(reason.shown(100), "") << "it does not come again";
  reason.say("no answer", 200);
  reason.say("", 300);
  EXPECT_EQ(reason.shown(300), "");
}

}  // namespace
}  // namespace zloam::ros
