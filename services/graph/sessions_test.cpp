// Separate drives, each in its own map, in one graph.

#include <gtest/gtest.h>

#include <algorithm>

#include "graph/loop_graph.hpp"
#include "graph/test_town.hpp"

namespace zloam::graph {
namespace {

/// The same drive in another map, whose origin is the drive's first pose, as at the start of a run.
TestDrive in_its_own_map(TestDrive driven) {
  const Pose T_own_told = driven.submaps.front().T_map_submap.inverse();
  Pose level = Pose::Identity();
  level.translation() = T_own_told.translation();
  level.linear() = T_own_told.linear();
  for (Submap& submap : driven.submaps) submap.T_map_submap = level * submap.T_map_submap;
  return driven;
}

std::vector<Pose> reversed(std::vector<Pose> poses) {
  std::reverse(poses.begin(), poses.end());
  for (Pose& pose : poses) pose.linear() = pose.linear() * pose_at(0.0, 0.0, 3.14159).linear();
  return poses;
}

void add(LoopGraph& graph, const TestDrive& driven, std::size_t session) {
  for (const Submap& submap : driven.submaps) graph.add(submap, session);
}

/// Largest position error of the second drive's submaps relative to the first drive's first submap.
double worst_between_m(const LoopGraph& graph, const TestDrive& first, const TestDrive& second) {
  const Pose T_truth_world = first.truth.front() * graph.nodes().front().T_world_submap.inverse();
  double worst = 0.0;
  for (std::size_t i = 0; i < second.truth.size(); ++i) {
    const Node& node = graph.nodes()[first.truth.size() + i];
    const Pose found = T_truth_world * node.T_world_submap;
    worst = std::max(worst, (found.translation() - second.truth[i].translation()).norm());
  }
  return worst;
}

std::vector<Pose> rotated(std::vector<Pose> poses, std::size_t by) {
  std::rotate(poses.begin(), poses.begin() + static_cast<std::ptrdiff_t>(by), poses.end());
  return poses;
}

TEST(Sessions, ADriveInAMapOfItsOwnIsLaidUponTheOther) {
  for (unsigned seed = 1; seed <= 3; ++seed) {
    TestTown town(seed);
    const std::vector<Pose> round = rounds(40.0, 1);
    for (const bool back : {false, true}) {
      const auto truth = rotated(back ? reversed(round) : round, 7);
      const TestDrive first = in_its_own_map(drive(town, round, 0.005, 0.0003, seed));
      const TestDrive second = in_its_own_map(drive(town, truth, 0.005, 0.0003, seed + 50));
      LoopGraph graph{GraphConfig{}};
      add(graph, first, 0);
      add(graph, second, 1);
      EXPECT_EQ(graph.frame_of(1), 0U) << seed << back;
      EXPECT_LT(worst_between_m(graph, first, second), 0.15) << seed << back;
    }
  }
}

TEST(Sessions, TheSecondOneCorrectsTheDriftOfTheFirst) {
  TestTown town(4);
  const std::vector<Pose> round = rounds(40.0, 1);
  const TestDrive first = in_its_own_map(drive(town, round, 0.0, 0.0, 4));
  const TestDrive second = in_its_own_map(drive(town, rotated(round, 5), 0.1, 0.006, 54));
  LoopGraph graph{GraphConfig{}};
  add(graph, first, 0);
  add(graph, second, 1);
  ASSERT_EQ(graph.frame_of(1), 0U);
  EXPECT_LT(worst_between_m(graph, first, second), 0.3);
}

TEST(Sessions, ThreeOfWhichTwoShareNothingAreJoinedByTheThird) {
  TestTown town(5, 260.0);
  std::vector<Pose> west, east, both;
  for (int i = 0; i < 9; ++i) west.push_back(pose_at(-100.0 + 10.0 * i, 0.0, 0.0));
  for (int i = 0; i < 9; ++i) east.push_back(pose_at(20.0 + 10.0 * i, 0.0, 0.0));
  for (int i = 0; i < 21; ++i) both.push_back(pose_at(-100.0 + 10.0 * i, 2.0, 0.0));
  LoopGraph graph{GraphConfig{}};
  add(graph, in_its_own_map(drive(town, west, 0.003, 0.0002, 5)), 0);
  add(graph, in_its_own_map(drive(town, east, 0.003, 0.0002, 6)), 1);
  EXPECT_EQ(graph.frame_of(1), 1U);
  add(graph, in_its_own_map(drive(town, both, 0.003, 0.0002, 7)), 2);
  EXPECT_EQ(graph.frame_of(1), 0U);
  EXPECT_EQ(graph.frame_of(2), 0U);
  const Pose between = graph.nodes()[0].T_world_submap.inverse() * graph.nodes()[9].T_world_submap;
  EXPECT_LT((between.translation() - Eigen::Vector3d(120.0, 0.0, 0.0)).norm(), 0.3);
}

// Each two loops agree within the drift that the way between them may cause, but the submaps' own
// covariances exclude it: all but one loop are taken back, and one joins nothing.
TEST(Sessions, OneLoopThatIsLeftOfThreeJoinsNothing) {
  TestTown town(1);
  const std::vector<Pose> round = rounds(40.0, 1);
  const std::vector<Pose> part(round.begin() + 7, round.begin() + 17);
  for (const double scale : {1.0, 1.05}) {
    TestDrive second = in_its_own_map(drive(town, part, 0.005, 0.0003, 51));
    for (Submap& submap : second.submaps) submap.T_map_submap.translation() *= scale;
    LoopGraph graph{GraphConfig{}};
    add(graph, in_its_own_map(drive(town, round, 0.005, 0.0003, 1)), 0);
    add(graph, second, 1);
    EXPECT_EQ(graph.frame_of(1), scale == 1.0 ? 0U : 1U) << scale;
  }
}

TEST(Sessions, OtherTownsAreNotJoined) {
  for (unsigned seed = 1; seed <= 8; ++seed) {
    TestTown here(seed), there(seed + 100);
    const std::vector<Pose> round = rounds(40.0, 1);
    LoopGraph graph{GraphConfig{}};
    add(graph, in_its_own_map(drive(here, round, 0.005, 0.0003, seed)), 0);
    add(graph, in_its_own_map(drive(there, round, 0.005, 0.0003, seed + 50)), 1);
    EXPECT_EQ(graph.frame_of(1), 1U) << seed;
  }
}

// Equal houses 20 m apart along a street that is seen only in part: a match displaced by one house
// is as good.
TEST(Sessions, AStreetThatRepeatsItselfJoinsNothing) {
  std::vector<Wall> walls;
  for (int i = -20; i < 20; ++i) {
    const double x = 20.0 * i;
    for (const double side : {-1.0, 1.0}) {
      walls.push_back({{x, 10.0 * side}, {x + 9.0, 10.0 * side}, 6.0});
      walls.push_back({{x, 10.0 * side}, {x, 18.0 * side}, 6.0});
      walls.push_back({{x + 9.0, 10.0 * side}, {x + 9.0, 18.0 * side}, 6.0});
    }
  }
  TestTown street(walls);
  std::vector<Pose> first, second;
  for (int i = 0; i < 16; ++i) first.push_back(pose_at(-80.0 + 10.0 * i, 0.0, 0.0));
  for (int i = 0; i < 16; ++i) second.push_back(pose_at(-60.0 + 10.0 * i, 0.5, 0.0));
  LoopGraph graph{GraphConfig{}};
  add(graph, in_its_own_map(drive(street, first, 0.003, 0.0002, 1)), 0);
  add(graph, in_its_own_map(drive(street, second, 0.003, 0.0002, 2)), 1);
  EXPECT_EQ(graph.frame_of(1), 1U);
}

}  // namespace
}  // namespace zloam::graph
