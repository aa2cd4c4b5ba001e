// From which publisher the store accepts messages, and which runs only look at its map.

#include "store/live_publisher.hpp"

#include <gtest/gtest.h>

#include <limits>

#include "store/generation.hpp"

namespace zloam::store {
namespace {

constexpr std::int64_t kSecond = 1'000'000'000;
constexpr std::int64_t kNow = 1'600'000'000 * kSecond;
const Source kMapping{1, 7, 0, "mapping-1"};

TEST(LivePublisher, NobodyIsBelievedBeforeItWasAsked) {
  EXPECT_FALSE(LivePublisher().believes(kMapping));
  EXPECT_FALSE(LivePublisher().believes(kMapping, kNow));
}

TEST(LivePublisher, AnotherMapTermRunOrInstanceIsNot) {
  LivePublisher p;
  p.answered(kMapping, kNow);
  EXPECT_TRUE(p.believes(kMapping));
  for (const Source& other : {Source{2, 7, 0, "mapping-1"}, Source{1, 8, 0, "mapping-1"},
                              Source{1, 7, 4'000'000'000U, "mapping-1"}, Source{1, 7, 0, "x"}}) {
    EXPECT_FALSE(p.believes(other));
    EXPECT_FALSE(p.believes(other, kNow));
  }
}

TEST(LivePublisher, AnInstantFarFromItsOthersIsNot) {
  LivePublisher p;
  p.answered(kMapping, kNow);
  EXPECT_TRUE(p.believes(kMapping, kNow + 9 * kSecond));
  using Limits = std::numeric_limits<std::int64_t>;
  for (const std::int64_t far :
       {kNow + 11 * kSecond, kNow - 11 * kSecond, std::int64_t{0}, Limits::max(), Limits::min()}) {
    EXPECT_FALSE(p.believes(kMapping, far)) << far;
  }
  // Each stored pose moves the limit along.
  for (int i = 1; i < 100; ++i) {
    ASSERT_TRUE(p.believes(kMapping, kNow + i * kSecond));
    p.stored(kNow + i * kSecond);
  }
}

TEST(LivePublisher, WhatItAnswersItselfIsBelieved) {
  LivePublisher p;
  p.answered(kMapping, kNow);
  p.answered(kMapping, kNow + 3600 * kSecond);  // the sensor was away for an hour
  EXPECT_TRUE(p.believes(kMapping, kNow + 3600 * kSecond));
  const Source again{1, 7, 0, "mapping-2"};
  p.answered(again, kNow);
  EXPECT_TRUE(p.believes(again, kNow));
  EXPECT_FALSE(p.believes(kMapping, kNow));
}

TEST(LivePublisher, AnAbsurdInstantOnDiskIsKnownForWhatItIs) {
  LivePublisher p;
  EXPECT_FALSE(p.is_beyond(std::numeric_limits<std::int64_t>::max()));  // nobody has been asked
  p.answered(kMapping, kNow);
  EXPECT_TRUE(p.is_beyond(std::numeric_limits<std::int64_t>::max()));
  EXPECT_FALSE(p.is_beyond(kNow));
  EXPECT_FALSE(p.is_beyond(kNow - 3600 * kSecond));
}

TEST(Extensions, ARunAfterOneThatExtendedTheMapOnlyLooksAtIt) {
  constexpr std::uint64_t kMap = 7, kExtending = 8, kLocalizing = 9;
  Extensions extensions;
  EXPECT_TRUE(extensions.only_looks(kExtending, kMap));
  extensions.tile_came(kExtending, kMap);
  EXPECT_FALSE(extensions.only_looks(kExtending, kMap));
  EXPECT_TRUE(extensions.only_looks(kLocalizing, kMap));
  EXPECT_FALSE(extensions.only_looks(kMap, kMap));
  extensions.tile_came(kMap, kMap);
  EXPECT_FALSE(extensions.only_looks(kExtending, kMap));
}

}  // namespace
}  // namespace zloam::store
