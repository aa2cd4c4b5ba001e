#include "graph/map_membership.hpp"

#include <gtest/gtest.h>

namespace zloam::graph {
namespace {

constexpr std::uint64_t kFirst = 7, kSecond = 8;

// The graph is behind: mapping was reset after the pose at 20, and a submap of the new map is
// handled while the newest pose is that at 10.
TEST(Membership, ASubmapBeforeTheLastPosesOfTheMapBeforeEndsNothing) {
  CurrentMap map{kFirst, 10};
  EXPECT_EQ(membership_of_submap(map, kSecond, 30), Membership::kEarly);
  EXPECT_EQ(membership_of_pose(map, kFirst, 20), Membership::kCurrent);
  map.newest_pose_ns = 20;
  EXPECT_EQ(membership_of_submap(map, kSecond, 30), Membership::kEarly);
  EXPECT_EQ(membership_of_pose(map, kSecond, 25), Membership::kBegins);
  map = {kSecond, 25};
  EXPECT_EQ(membership_of_submap(map, kSecond, 30), Membership::kCurrent);
}

TEST(Membership, ALateMessageOfAMapBeforeBeginsNothing) {
  const CurrentMap map{kSecond, 25};
  EXPECT_EQ(membership_of_pose(map, kFirst, 20), Membership::kPast);
  EXPECT_EQ(membership_of_submap(map, kFirst, 15), Membership::kPast);
}

TEST(Membership, WithoutAPoseOnlyAPoseBeginsAnotherMap) {
  CurrentMap map{kFirst, std::nullopt};
  EXPECT_EQ(membership_of_submap(map, kSecond, 5), Membership::kEarly);
  EXPECT_EQ(membership_of_pose(map, kSecond, 5), Membership::kBegins);
  map.starts_late = true;
  EXPECT_EQ(membership_of_submap(map, kFirst, 5), Membership::kCurrent);
}

// The first message of a run that is handled is a submap after a reset, and names the map: the
// poses before the reset come after it.
TEST(Membership, ASubmapThatIsARunsFirstMessageWaitsForItsMap) {
  CurrentMap map{kSecond, std::nullopt};
  EXPECT_EQ(membership_of_submap(map, kSecond, 30), Membership::kEarly);
  EXPECT_EQ(membership_of_pose(map, kFirst, 10), Membership::kBegins);
  map = {kFirst, 10};
  EXPECT_EQ(membership_of_submap(map, kSecond, 30), Membership::kEarly);
  map = {kSecond, 25};
  EXPECT_EQ(membership_of_submap(map, kSecond, 30), Membership::kCurrent);
}

}  // namespace
}  // namespace zloam::graph
