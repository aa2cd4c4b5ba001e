#include "ros/shown_tiles.hpp"

#include <gtest/gtest.h>

namespace zloam::ros {
namespace {

using Taken = ShownTiles::Taken;
const std::vector<MapPoint> kOne = {{1.0F, 2.0F, 3.0F, 4.0F}};

// 50 m of a street have two tiles of points, and dozens of cubes of voxels.
TEST(ShownTiles, CubesOfVoxelsTakeNoRoom) {
  ShownTiles tiles;
  EXPECT_EQ(tiles.take("voxels", "voxels/0/0/0", {1, 1}, {}), Taken::kNone);
  EXPECT_TRUE(tiles.empty());
  for (std::size_t i = 0; i < ShownTiles::kMost; ++i) {
    ASSERT_EQ(tiles.take("plane", "plane/" + std::to_string(i), {1, 1}, {}), Taken::kTaken);
  }
  EXPECT_EQ(tiles.take("voxels", "voxels/0/0/0", {1, 1}, {}), Taken::kNone);
  EXPECT_EQ(tiles.take("edge", "edge/0/0/0", {1, 1}, kOne), Taken::kFull);
  EXPECT_EQ(tiles.take("plane", "plane/7", {1, 2}, kOne), Taken::kTaken);
  EXPECT_EQ(tiles.points().size(), 1U);
}

TEST(ShownTiles, TheNewestStateCountsAlsoWhereItIsEmpty) {
  ShownTiles tiles;
  EXPECT_EQ(tiles.take("edge", "edge/0/0/0", {1, 5}, kOne), Taken::kTaken);
  EXPECT_EQ(tiles.take("edge", "edge/0/0/0", {2, 1}, {}), Taken::kTaken);
  EXPECT_EQ(tiles.take("edge", "edge/0/0/0", {1, 6}, kOne), Taken::kNone);
  EXPECT_TRUE(tiles.points().empty());
}

}  // namespace
}  // namespace zloam::ros
