// The map's cubes against independently computed means, and scan to map against the poses at which
// the sweeps were simulated.

#include "aloam/core/scan_to_map.hpp"

#include <gtest/gtest.h>

#include <map>
#include <random>

#include "aloam/core/scan_registration.hpp"
#include "aloam/core/test_room.hpp"
#include "aloam/mapping/taken_back.hpp"

namespace zloam::aloam {
namespace {

TEST(CubeMap, CubesSpanWholeFiftyMetres) {
  EXPECT_EQ(cube_index({0.0, 49.9, 50.0}).at, (std::array<std::int32_t, 3>{0, 0, 1}));
  EXPECT_EQ(cube_index({-0.1, -50.0, -50.1}).at, (std::array<std::int32_t, 3>{-1, -1, -2}));
}

TEST(CubeMap, AveragesTheLocalCubesByVoxel) {
  std::mt19937 generator(3);
  std::uniform_real_distribution<float> along(1.0F, 6.0F);
  CubeMap map(0.2, 0.4);
  Cloud planes;
  std::map<std::array<int, 3>, std::pair<Eigen::Vector3d, int>> truth;
  for (int i = 0; i < 3000; ++i) {
    const pcl::PointXYZI p = map_point(along(generator), along(generator), along(generator), 1.0F);
    planes.push_back(p);
    auto& [sum, n] = truth[{static_cast<int>(p.x / 0.4F), static_cast<int>(p.y / 0.4F),
                            static_cast<int>(p.z / 0.4F)}];
    sum = n == 0 ? position_of(p) : Eigen::Vector3d(sum + position_of(p));
    ++n;
  }
  map.insert({}, planes);
  map.filter_local();
  ASSERT_EQ(map.cubes().size(), 1u);
  const Cloud& found = *map.cubes().begin()->second.planes;
  ASSERT_EQ(found.size(), truth.size());
  for (const pcl::PointXYZI& p : found) {
    const auto& [sum, n] = truth[{static_cast<int>(p.x / 0.4F), static_cast<int>(p.y / 0.4F),
                                  static_cast<int>(p.z / 0.4F)}];
    EXPECT_LT((position_of(p) - sum / n).norm(), 1e-5);
  }
}

TEST(CubeMap, ForgetsWhatLeavesTheWindow) {
  CubeMap map(0.2, 0.4);
  Cloud here, there;
  here.push_back(map_point(1.0F, 1.0F, 1.0F, 0.0F));
  map.insert(here, {});
  // At first the window is cubes -10 to 10. At cube 7 the sensor is three cubes from its border; at
  // cube 17 it has moved the window by ten cubes, and the point's cube 0 is at its border.
  for (const double x : {375.0, 875.0}) {
    map.follow({x, 0.0, 0.0});
    EXPECT_EQ(map.point_count(), 1u) << x;
  }
  map.follow({925.0, 0.0, 0.0});
  EXPECT_EQ(map.point_count(), 0u);
  EXPECT_EQ(map.forgotten(), 1u);
  there.push_back(map_point(926.0F, 0.0F, 0.0F, 0.0F));
  map.insert(there, here);
  EXPECT_EQ(map.point_count(), 1u) << "what lies outside the window is not taken";
}

TEST(CubeMap, TheLocalMapIsTwoCubesEitherWayAndOneInHeight) {
  CubeMap map(0.2, 0.4);
  Cloud points;
  for (const float x : {-125.0F, -75.0F, 25.0F, 125.0F, 175.0F}) {
    points.push_back(map_point(x, 25.0F, 25.0F, 0.0F));
  }
  points.push_back(map_point(25.0F, 25.0F, 75.0F, 0.0F));
  points.push_back(map_point(25.0F, 25.0F, 125.0F, 0.0F));
  map.insert(points, {});
  map.follow({25.0, 25.0, 25.0});
  EXPECT_EQ(map.local().edges->size(), 4u);
}

TEST(CubeMap, NamesEachChangedCubeOnce) {
  CubeMap map(0.2, 0.4);
  Cloud points;
  points.push_back(map_point(1.0F, 1.0F, 1.0F, 0.0F));
  points.push_back(map_point(-1.0F, 1.0F, 1.0F, 0.0F));
  points.push_back(map_point(2.0F, 1.0F, 1.0F, 0.0F));
  map.insert(points, points);
  EXPECT_EQ(map.take_changed().size(), 2u);
  EXPECT_TRUE(map.take_changed().empty());
  map.insert(points, {});
  EXPECT_EQ(map.cubes().at(cube_index({1.0, 1.0, 1.0})).version, 2u);
}

// A sweep from the middle of this cube, of one point there.
void visit(CubeMap& map, int cube) {
  const double x_m = kCube_m * (cube + 0.5);
  map.follow({x_m, 0.0, 0.0});
  Cloud seen;
  seen.push_back(map_point(static_cast<float>(x_m), 0.0F, 0.0F, 0.0F));
  map.insert(seen, {});
}

TEST(CubeMap, ACubeSeenAgainAfterItWasForgottenIsNewerThanBefore) {
  CubeMap map(0.2, 0.4);
  for (int i = 0; i < 5; ++i) visit(map, 0);
  const std::uint64_t before = map.cubes().at(cube_index({25.0, 0.0, 0.0})).version;
  visit(map, 20);
  ASSERT_FALSE(map.cubes().contains(cube_index({25.0, 0.0, 0.0})));
  visit(map, 0);
  EXPECT_GT(map.cubes().at(cube_index({25.0, 0.0, 0.0})).version, before);
}

TEST(CubeMap, AnotherInstanceHasTheSameCubes) {
  CubeMap map(0.2, 0.4);
  for (int cube = 0; cube <= 20; ++cube) visit(map, cube);
  for (int cube = 20; cube >= 10; --cube) visit(map, cube);
  // Cubes 3 to 20 are left of 0 to 20.
  ASSERT_EQ(map.cubes().size(), 18u);
  CubeMap other(0.2, 0.4);
  other.restore(map.cubes(), {525.0, 0.0, 0.0});
  ASSERT_EQ(other.cubes().size(), 18u);
  EXPECT_EQ(other.forgotten(), 0u);
  visit(map, 10);
  visit(other, 10);
  for (const auto& [index, cube] : map.cubes()) {
    ASSERT_TRUE(other.cubes().contains(index)) << index.at[0];
    EXPECT_EQ(other.cubes().at(index).version, cube.version) << index.at[0];
  }
}

TEST(CubeMap, OfMoreCubesThanFitTheNewestStay) {
  CubeMap out(0.2, 0.4);
  std::map<CubeIndex, Cube> stored;
  for (int i = 0; i <= 30; ++i) {
    visit(out, i);
    for (const auto& [index, cube] : out.cubes()) stored[index] = cube;
  }
  CubeMap other(0.2, 0.4);
  other.restore(stored, {1525.0, 0.0, 0.0});
  EXPECT_EQ(other.cubes().size(), out.cubes().size());
  for (const auto& [index, cube] : out.cubes()) EXPECT_TRUE(other.cubes().contains(index));
}

TEST(TakenBack, OfACubeThatIsSentTwiceTheNewerStays) {
  const auto points = [](std::size_t count) {
    Cloud::Ptr cloud(new Cloud);
    cloud->resize(count);
    return cloud;
  };
  const CubeIndex index{{1, 2, 3}};
  TakenBack taken;
  taken.add(index, Layer::kEdge, {2, 8}, points(80));
  taken.add(index, Layer::kEdge, {2, 5}, points(50));
  taken.add(index, Layer::kPlane, {1, 9}, points(90));
  taken.add(index, Layer::kPlane, {2, 4}, points(40));
  const std::map<CubeIndex, Cube> cubes = taken.take();
  ASSERT_EQ(cubes.size(), 1U);
  EXPECT_EQ(cubes.at(index).edges->size(), 80U);
  EXPECT_EQ(cubes.at(index).planes->size(), 40U);
}

TEST(ScanToMap, CorrectsAnOdometryThatIsOff) {
  ScanToMap mapping({});
  const Pose per_sweep = exp_se3((Vector6() << 0.1, 0.02, 0.0, 0.0, 0.0, 0.01).finished());
  const Pose drift = exp_se3((Vector6() << 0.03, -0.02, 0.01, 0.001, 0.0, -0.003).finished());
  Pose T = Pose::Identity(), odometry = Pose::Identity();
  for (int k = 0; k < 10; ++k) {
    const ScanFeatures f = extract_features(test::sweep_at(T, 0.01, 1 + k), 0.3);
    const Mapped found = mapping.process(f.less_sharp, f.less_flat, odometry);
    EXPECT_EQ(found.matched, k > 0);
    EXPECT_LT((found.T_map_base.translation() - T.translation()).norm(), 0.05) << k;
    EXPECT_LT(log_so3(found.T_map_base.linear().transpose() * T.linear()).norm(), 0.01) << k;
    const Pose composed = mapping.T_map_odom() * odometry;
    EXPECT_LT((composed.matrix() - found.T_map_base.matrix()).norm(), 1e-9);
    T = T * per_sweep;
    odometry = odometry * per_sweep * drift;
  }
}

TEST(ScanToMap, ANewOdomFrameGoesOnWhereTheLastPoseWas) {
  ScanToMap mapping({});
  const Pose T = exp_se3((Vector6() << 1.0, 0.5, 0.0, 0.0, 0.0, 0.2).finished());
  const ScanFeatures f = extract_features(test::sweep_at(T), 0.3);
  mapping.process(f.less_sharp, f.less_flat, T);
  mapping.continue_from(Pose::Identity());
  const Mapped found = mapping.process(f.less_sharp, f.less_flat, Pose::Identity());
  EXPECT_LT((found.T_map_base.translation() - T.translation()).norm(), 0.01);
}

TEST(ScanToMap, AFewMatchesAreNone) {
  constexpr std::size_t kFew = 9;
  ScanToMap mapping({});
  const ScanFeatures f = extract_features(test::sweep_at(Pose::Identity()), 0.3);
  mapping.process(f.less_sharp, f.less_flat, Pose::Identity());
  PointVector few;
  for (std::size_t i = 0; i < kFew; ++i) {
    few.push_back(f.less_flat[i * f.less_flat.size() / kFew]);
  }
  const Pose T_odom_base = exp_se3((Vector6() << 0.1, 0.0, 0.0, 0.0, 0.0, 0.01).finished());
  const Mapped found = mapping.process({}, few, T_odom_base);
  EXPECT_GT(found.planes, 0U);
  EXPECT_LE(found.planes, kFew);
  EXPECT_FALSE(found.matched);
  EXPECT_TRUE(found.T_map_base.isApprox(T_odom_base, 1e-9));
}

TEST(ScanToMap, TakesSweepsWithoutPoints) {
  ScanToMap mapping({});
  const Mapped found = mapping.process({}, {}, Pose::Identity());
  EXPECT_FALSE(found.matched);
  EXPECT_TRUE(found.T_map_base.matrix().allFinite());
}

}  // namespace
}  // namespace zloam::aloam
