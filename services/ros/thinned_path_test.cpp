#include "ros/thinned_path.hpp"

#include <gtest/gtest.h>

namespace zloam::ros {
namespace {

TEST(ThinnedPath, KeepsEveryPoseOfAShortRun) {
  ThinnedPath path;
  for (std::int64_t n = 0; n < 5000; ++n) path.add(n, Pose::Identity());
  ASSERT_EQ(path.poses().size(), 5000U);
  EXPECT_EQ(path.poses()[4321].first, 4321);
  path.clear();
  EXPECT_TRUE(path.poses().empty());
}

TEST(ThinnedPath, OfALongRunThePosesAreEvenlySpacedFromTheFirstToTheNewest) {
  ThinnedPath path;
  constexpr std::int64_t kPoses = 1'000'000;
  for (std::int64_t n = 0; n < kPoses; ++n) path.add(n, Pose::Identity());
  const auto poses = path.poses();
  ASSERT_LE(poses.size(), ThinnedPath::kMost);
  ASSERT_GE(poses.size(), ThinnedPath::kMost / 2);
  EXPECT_EQ(poses.front().first, 0);
  const std::int64_t step = poses[1].first;
  for (std::size_t i = 1; i + 1 < poses.size(); ++i) {
    ASSERT_EQ(poses[i].first - poses[i - 1].first, step);
  }
  EXPECT_EQ(poses.back().first, kPoses - 1);
}

TEST(ThinnedPath, TimeAscendsAlsoWithPosesThatComeLate) {
  ThinnedPath path;
  for (const std::int64_t n : {10, 11, 13, 12, 14, 13}) path.add(n, Pose::Identity());
  std::vector<std::int64_t> times_ns;
  for (const auto& [stamp_ns, pose] : path.poses()) times_ns.push_back(stamp_ns);
  EXPECT_EQ(times_ns, (std::vector<std::int64_t>{10, 11, 13, 14}));
}

// Nothing else tells of the second replay: it has the same run.
TEST(ThinnedPath, OfARecordingThatIsReplayedAgainThePathBeginsAnew) {
  ThinnedPath path;
  for (const std::int64_t n : {10, 11, 12, 10, 11}) path.add(n, Pose::Identity());
  ASSERT_EQ(path.poses().size(), 2U);
  EXPECT_EQ(path.poses().back().first, 11);
}

TEST(ThinnedPath, AnotherMapBeginsAnotherPath) {
  ThinnedPath path;
  path.add(10, Pose::Identity());
  // The first poses of a run come before mapping has named its map.
  path.in_map(7);
  path.add(11, Pose::Identity());
  path.in_map(7);
  EXPECT_EQ(path.poses().size(), 2U);
  path.in_map(8);
  EXPECT_TRUE(path.poses().empty());
  path.add(12, Pose::Identity());
  path.in_map(8);
  ASSERT_EQ(path.poses().size(), 1U);
  EXPECT_EQ(path.poses().front().first, 12);
}

}  // namespace
}  // namespace zloam::ros
