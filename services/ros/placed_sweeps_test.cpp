#include "ros/placed_sweeps.hpp"

#include <gtest/gtest.h>

namespace zloam::ros {
namespace {

TEST(PlacedSweeps, ACloudIsShownOnlyIfItsOwnPoseIsKnown) {
  PlacedSweeps sweeps;
  sweeps.add(7, true);
  sweeps.add(8, false);
  sweeps.add(9, true);
  EXPECT_EQ(sweeps.find(7), std::optional(true));
  EXPECT_EQ(sweeps.find(8), std::optional(false));
  EXPECT_EQ(sweeps.find(9), std::optional(true));
}

TEST(PlacedSweeps, ACloudThatComesBeforeItsPoseWaits) {
  PlacedSweeps sweeps;
  EXPECT_EQ(sweeps.find(0), std::nullopt);
  sweeps.add(0, true);
  EXPECT_EQ(sweeps.find(1), std::nullopt);
  sweeps.add(1, false);
  EXPECT_EQ(sweeps.find(1), std::optional(false));
}

TEST(PlacedSweeps, ASweepWithoutAPoseIsNotShown) {
  PlacedSweeps sweeps;
  sweeps.add(4, true);
  sweeps.add(6, true);
  EXPECT_EQ(sweeps.find(5), std::optional(false));
}

TEST(PlacedSweeps, OldSweepsAndThoseOfAnEarlierRunAreForgotten) {
  PlacedSweeps sweeps;
  for (std::uint64_t n = 0; n <= PlacedSweeps::kMost; ++n) sweeps.add(n, true);
  EXPECT_EQ(sweeps.find(0), std::optional(false));
  EXPECT_EQ(sweeps.find(1), std::optional(true));
  sweeps.clear();
  EXPECT_EQ(sweeps.find(1), std::nullopt);
}

}  // namespace
}  // namespace zloam::ros
