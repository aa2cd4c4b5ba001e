#include "common/runtime/lost_map.hpp"

#include <gtest/gtest.h>

namespace zloam::runtime {
namespace {

constexpr std::uint64_t kRun = 1'700'000'000'000'000'000;
constexpr int kKept = 32;

TEST(LostMap, TheNextMapHasAnIdOfItsOwn) {
  EarlierIds ids;
  ids.add(kRun);
  EXPECT_EQ(ids.next(kRun, 45), kRun + 1);
}

TEST(LostMap, TheNextMapIsNewerThanThoseAfterResets) {
  EarlierIds ids;
  ids.add(kRun + 2);
  ids.add(kRun);
  EXPECT_EQ(ids.newest(), kRun + 2);
  EXPECT_EQ(ids.next(kRun, 45), kRun + 3);
}

TEST(LostMap, WithoutAWitnessTheIdIsNeitherTheFirstMapsNorThatAfterAReset) {
  const EarlierIds ids;
  EXPECT_FALSE(ids.newest());
  EXPECT_GT(ids.next(kRun, 45), kRun + 1);
}

TEST(LostMap, AStageThatStartsWithTheOthersFollowsNone) {
  EXPECT_FALSE(may_follow_another(false, 0, kKept));
  EXPECT_FALSE(may_follow_another(false, 5, kKept));
  EXPECT_TRUE(may_follow_another(false, 45, kKept));
}

TEST(LostMap, AReplayWaitsForItsStages) {
  EXPECT_FALSE(may_follow_another(true, 0, kKept));
  EXPECT_TRUE(may_follow_another(true, 1, kKept));
}

TEST(LostMap, TheStatusTellsWhetherTheFrameStays) {
  EXPECT_EQ(lost_map_text(45),
            "the map before sweep 45 is lost: no store has it; a new one begins in its frame");
  EXPECT_EQ(lost_frame_text(45),
            "any map before sweep 45 and its frame are lost: neither a store nor integration has "
            "them; a new one begins in the odometry's frame");
  EXPECT_NE(lost_map_text(45, "its voxels have other sizes").find("other sizes"),
            std::string::npos);
}

}  // namespace
}  // namespace zloam::runtime
