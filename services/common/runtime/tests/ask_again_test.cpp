#include "common/runtime/ask_again.hpp"

#include <gtest/gtest.h>

namespace zloam::runtime {
namespace {

TEST(AskAgain, AsksOnceForWhatCame) {
  AskAgain tiles;
  EXPECT_FALSE(tiles.due(0));
  tiles.want();
  EXPECT_TRUE(tiles.due(0));
  tiles.asked();
  tiles.answered(true, 1);
  EXPECT_FALSE(tiles.due(AskAgain::kLongestPause_ns * 2));
}

TEST(AskAgain, AsksAgainForWhatDidNotComeAfterAPauseThatGrows) {
  AskAgain tiles;
  std::int64_t now_ns = 0, pause_ns = AskAgain::kFirstPause_ns;
  tiles.want();
  for (int i = 0; i < 10; ++i) {
    tiles.asked();
    tiles.answered(false, now_ns);
    EXPECT_FALSE(tiles.due(now_ns + pause_ns - 1)) << i;
    now_ns += pause_ns;
    EXPECT_TRUE(tiles.due(now_ns)) << i;
    pause_ns = std::min(2 * pause_ns, AskAgain::kLongestPause_ns);
  }
  tiles.asked();
  tiles.answered(true, now_ns);
  EXPECT_FALSE(tiles.due(now_ns + AskAgain::kLongestPause_ns));
}

TEST(AskAgain, AsksForAnotherMapAtOnce) {
  AskAgain tiles;
  tiles.want();
  tiles.asked();
  tiles.want();
  tiles.answered(false, 0);
  EXPECT_TRUE(tiles.due(0));
  tiles.asked();
  tiles.answered(false, 0);
  EXPECT_FALSE(tiles.due(0));
  tiles.want();
  EXPECT_TRUE(tiles.due(0));
}

}  // namespace
}  // namespace zloam::runtime
