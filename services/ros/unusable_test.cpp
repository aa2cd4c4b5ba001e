#include "ros/unusable.hpp"

#include <gtest/gtest.h>

namespace zloam::ros {
namespace {

constexpr std::int64_t kLook_ns = 20'000'000;

TEST(Unusable, AFewOfManyMessagesAreCountedAndShown) {
  Unusable unusable;
  std::int64_t now_ns = kLook_ns;
  EXPECT_EQ(unusable.shown(now_ns), 0U);
  // Every tenth look finds two of them.
  for (int look = 0; look < 100; ++look, now_ns += kLook_ns) {
    unusable.add(look % 10 == 0 ? 2 : 0, now_ns);
    EXPECT_EQ(unusable.shown(now_ns), 2U * static_cast<unsigned>(look / 10 + 1));
  }
}

TEST(Unusable, WhatIsOverIsForgotten) {
  Unusable unusable;
  unusable.add(3, 0);
  EXPECT_EQ(unusable.shown(Unusable::kShown_ns), 3U);
  EXPECT_EQ(unusable.shown(Unusable::kShown_ns + 1), 0U);
  unusable.add(1, Unusable::kShown_ns + 2);
  EXPECT_EQ(unusable.shown(Unusable::kShown_ns + 2), 1U);
}

}  // namespace
}  // namespace zloam::ros
