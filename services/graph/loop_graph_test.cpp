#include "graph/loop_graph.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <tuple>

#include "graph/test_town.hpp"

namespace zloam::graph {
namespace {

double rms_off(const std::vector<Pose>& poses, const std::vector<Pose>& truth) {
  double sum = 0.0;
  for (std::size_t i = 0; i < truth.size(); ++i) {
    sum += (poses[i].translation() - truth[i].translation()).squaredNorm();
  }
  return std::sqrt(sum / static_cast<double>(truth.size()));
}

struct Ran {
  LoopGraph graph;
  std::vector<Pose> mapped, world;
};

Ran run(const TestDrive& drive) {
  Ran out{LoopGraph(GraphConfig{}), {}, {}};
  for (const Submap& submap : drive.submaps) out.graph.add(submap);
  for (const Node& node : out.graph.nodes()) {
    out.mapped.push_back(node.T_map_submap);
    out.world.push_back(node.T_world_submap);
  }
  return out;
}

// Largest position error of the loops in force.
double worst_loop_m(const LoopGraph& graph, const TestDrive& drive) {
  double worst = 0.0;
  for (const Loop& loop : graph.loops()) {
    if (loop.verdict != Verdict::kAccepted) continue;
    const Pose real = drive.truth[loop.from].inverse() * drive.truth[loop.to];
    worst = std::max(worst, (loop.T_from_to.translation() - real.translation()).norm());
  }
  return worst;
}

TEST(LoopGraph, ClosesLoopsOfADriftingDrive) {
  for (unsigned seed = 1; seed <= 3; ++seed) {
    TestTown town(seed);
    const TestDrive driven = drive(town, rounds(40.0, 2), 0.1, 0.006, seed);
    const Ran ran = run(driven);
    EXPECT_GE(ran.graph.loops_in_force(), 15U) << seed;
    EXPECT_LT(worst_loop_m(ran.graph, driven), 0.1) << seed;
    EXPECT_GT(rms_off(ran.mapped, driven.truth), 0.4) << seed;
    EXPECT_LT(rms_off(ran.world, driven.truth), 0.5 * rms_off(ran.mapped, driven.truth)) << seed;
  }
}

TEST(LoopGraph, FindsAPlaceAgainFromTheOtherSide) {
  TestTown town(4);
  const TestDrive driven = drive(town, rounds(40.0, 2, true), 0.05, 0.003, 4);
  const Ran ran = run(driven);
  EXPECT_GE(ran.graph.loops_in_force(), 15U);
  EXPECT_LT(worst_loop_m(ran.graph, driven), 0.1);
}

TEST(LoopGraph, MovesNothingWhereMappingIsRight) {
  TestTown town(5);
  const TestDrive driven = drive(town, rounds(40.0, 2), 0.0, 0.0, 5);
  const Ran ran = run(driven);
  EXPECT_GE(ran.graph.loops_in_force(), 10U);
  EXPECT_EQ(ran.graph.revision(), 0U);
  EXPECT_LT(rms_off(ran.world, driven.truth), 1e-9);
}

// Two identical street squares, 150 m apart: a loop that the way between excludes is not accepted,
// however well it matches.
TEST(LoopGraph, EqualPlacesFarApartAreNoLoop) {
  for (unsigned seed = 1; seed <= 5; ++seed) {
    TestTown here(seed, 80.0);
    std::vector<Pose> truth, there;
    for (int i = 0; i < 8; ++i) truth.push_back(pose_at(-30.0 + 8.0 * i, 0.0, 0.0));
    for (int i = 0; i < 8; ++i) there.push_back(pose_at(120.0 + 8.0 * i, 0.0, 0.0));
    TestDrive driven = drive(here, truth, 0.02, 0.001, seed);
    std::vector<Pose> all = truth;
    all.insert(all.end(), there.begin(), there.end());
    TestTown nothing(std::vector<Wall>{});
    TestDrive whole = drive(nothing, all, 0.02, 0.001, seed);
    // The second square looks exactly like the first one.
    for (std::size_t i = 0; i < 16; ++i) {
      whole.submaps[i].points = here.seen_from(truth[i % 8]);
    }
    const Ran ran = run(whole);
    EXPECT_EQ(ran.graph.loops_in_force(), 0U) << seed;
    EXPECT_EQ(ran.graph.revision(), 0U) << seed;
  }
}

std::vector<Eigen::Matrix4d> world_of(const LoopGraph& graph) {
  std::vector<Eigen::Matrix4d> poses;
  for (const Node& node : graph.nodes()) poses.push_back(node.T_world_submap.matrix());
  return poses;
}

/// Removes the oldest loop in force.
Loop remove_one(LoopGraph& graph) {
  const std::vector<Loop> loops = graph.loops();
  const auto found = std::ranges::find(loops, Verdict::kAccepted, &Loop::verdict);
  EXPECT_TRUE(graph.remove(found->from, found->to));
  return *found;
}

// The second round is stretched, by less than mapping may drift, but more than its covariances
// allow: each of its loops contradicts all others.
TestDrive stretched_drive(TestTown& town) {
  TestDrive driven = drive(town, rounds(40.0, 2), 0.005, 0.0003, 1);
  const std::size_t half = driven.submaps.size() / 2;
  const Eigen::Vector3d begin = driven.submaps[half].T_map_submap.translation();
  for (std::size_t i = half; i < driven.submaps.size(); ++i) {
    auto at = driven.submaps[i].T_map_submap.translation();
    at = (begin + 1.05 * (at - begin)).eval();
  }
  driven.submaps[half].step_covariance.diagonal() << 9.0, 9.0, 1e-2, 1e-4, 1e-4, 1e-2;
  return driven;
}

std::vector<Loop> taken_back(const LoopGraph& graph) {
  std::vector<Loop> loops = graph.loops();
  std::erase_if(loops, [](const Loop& loop) { return loop.verdict != Verdict::kTakenBack; });
  return loops;
}

TEST(LoopGraph, WithoutALoopThoseCountAgainThatContradictedIt) {
  TestTown town(1);
  Ran ran = run(stretched_drive(town));
  ASSERT_GT(taken_back(ran.graph).size(), 2U);
  const std::size_t in_force = ran.graph.loops_in_force();
  for (std::size_t i = 0; i < in_force; ++i) remove_one(ran.graph);
  EXPECT_GT(ran.graph.loops_in_force(), 0U);
}

TEST(LoopGraph, ARemovalTellsOfEachLoopWhoseVerdictItChanges) {
  TestTown town(1);
  Ran ran = run(stretched_drive(town));
  std::size_t again = 0;
  while (ran.graph.loops_in_force() > 0) {
    const std::vector<Loop> before = ran.graph.loops();
    const auto first = std::ranges::find(before, Verdict::kAccepted, &Loop::verdict);
    const auto update = ran.graph.remove(first->from, first->to);
    ASSERT_TRUE(update.has_value());
    const std::vector<Loop> after = ran.graph.loops();
    ASSERT_EQ(after.size(), before.size());
    auto told = update->loops.begin();
    for (std::size_t i = 0; i < after.size(); ++i) {
      if (after[i].verdict == before[i].verdict) continue;
      ASSERT_NE(told, update->loops.end()) << i;
      EXPECT_EQ(std::tuple(told->from, told->to, told->verdict),
                std::tuple(after[i].from, after[i].to, after[i].verdict));
      again += told->verdict == Verdict::kAccepted ? 1 : 0;
      ++told;
    }
    EXPECT_EQ(told, update->loops.end());
  }
  EXPECT_GT(again, 0U);
}

// The fewer loops are in force, the more of them a false one outweighs at first.
TEST(LoopGraph, OfALoopThatIsRefusedNothingIsLeft) {
  TestTown town(1);
  Ran ran = run(stretched_drive(town));
  const auto figures = [&] {
    const LoopGraph& graph = ran.graph;
    return std::tuple(graph.revision(), graph.chi2_after(), graph.last_move_m());
  };
  for (; ran.graph.loops_in_force() > 0; remove_one(ran.graph)) {
    const std::vector<Loop> contradicting = taken_back(ran.graph);
    if (contradicting.empty()) break;
    const Loop& loop = contradicting.front();
    const auto world = world_of(ran.graph);
    const auto before = figures();
    const Update update = ran.graph.add_loop(loop.from, loop.to, false);
    EXPECT_NE(update.loops.back().verdict, Verdict::kAccepted) << loop.from << " to " << loop.to;
    EXPECT_EQ(figures(), before) << loop.from << " to " << loop.to;
    EXPECT_EQ(world_of(ran.graph), world) << loop.from << " to " << loop.to;
  }
}

TEST(LoopGraph, WithoutALoopAllIsAsIfItHadNeverBeen) {
  TestTown town(6);
  const TestDrive driven = drive(town, rounds(40.0, 2), 0.1, 0.006, 6);
  Ran ran = run(driven);
  ASSERT_GT(ran.graph.loops_in_force(), 0U);
  const Loop first = remove_one(ran.graph);
  EXPECT_FALSE(ran.graph.remove(first.from, first.to));
  while (ran.graph.loops_in_force() > 0) remove_one(ran.graph);
  Ran without{LoopGraph(GraphConfig{}), {}, {}};
  for (std::size_t i = 0; i < driven.submaps.size(); ++i) {
    const Node& node = ran.graph.nodes()[i];
    const Pose& mapped = driven.submaps[i].T_map_submap;
    EXPECT_LT((node.T_world_submap.matrix() - mapped.matrix()).norm(), 1e-12) << i;
  }
}

std::vector<std::pair<std::size_t, std::size_t>> ends_in_force(const LoopGraph& graph) {
  std::vector<std::pair<std::size_t, std::size_t>> ends;
  for (const Loop& loop : graph.loops()) {
    if (loop.verdict == Verdict::kAccepted) ends.emplace_back(loop.from, loop.to);
  }
  std::ranges::sort(ends);
  return ends;
}

TEST(LoopGraph, ALoopThatAUserNamesIsVerified) {
  TestTown town(6);
  const TestDrive driven = drive(town, rounds(40.0, 2), 0.1, 0.006, 6);
  Ran ran = run(driven);
  const auto before = world_of(ran.graph);
  const Loop first = remove_one(ran.graph);
  ASSERT_NE(world_of(ran.graph), before);
  const Update added = ran.graph.add_loop(first.from, first.to, false);
  EXPECT_EQ(added.loops.back().verdict, Verdict::kAccepted);
  EXPECT_TRUE(added.revised);
  const Pose real = driven.truth[first.from].inverse() * driven.truth[first.to];
  const Pose& found = added.loops.back().T_from_to;
  EXPECT_LT((found.translation() - real.translation()).norm(), 0.1);
}

/// A submap of the second round on the other side of the town than `from`.
std::size_t opposite(const TestDrive& driven, std::size_t from) {
  std::size_t farthest = driven.truth.size() / 2;
  const auto distance = [&](std::size_t i) {
    return (driven.truth[i].translation() - driven.truth[from].translation()).norm();
  };
  for (std::size_t i = farthest; i < driven.truth.size(); ++i) {
    if (distance(i) > distance(farthest)) farthest = i;
  }
  return farthest;
}

/// Names false loops in the graphs of three drives, between opposite sides of the town. Afterwards
/// poses and loops must be as before: `named` (graph, from, to) puts back what it changes.
template <class Named>
void for_false_loops(const Named& named) {
  for (unsigned seed = 1; seed <= 3; ++seed) {
    TestTown town(seed);
    const TestDrive driven = drive(town, rounds(40.0, 2), 0.1, 0.006, seed);
    Ran ran = run(driven);
    const auto before = world_of(ran.graph);
    const auto ends = ends_in_force(ran.graph);
    for (std::size_t from = 0; from < 20; from += 5) {
      SCOPED_TRACE(testing::Message() << "seed " << seed << " from " << from);
      named(ran.graph, from, opposite(driven, from));
      EXPECT_EQ(world_of(ran.graph), before);
      EXPECT_EQ(ends_in_force(ran.graph), ends);
    }
  }
}

TEST(LoopGraph, AFalseLoopThatAUserNamesIsRefused) {
  for_false_loops([](LoopGraph& graph, std::size_t from, std::size_t to) {
    EXPECT_NE(graph.add_loop(from, to, false).loops.back().verdict, Verdict::kAccepted);
  });
}

TEST(LoopGraph, AForcedLoopHoldsUntilItIsRemovedAndLeavesNothing) {
  std::size_t forced = 0;
  for_false_loops([&forced](LoopGraph& graph, std::size_t from, std::size_t to) {
    if (graph.add_loop(from, to, true).loops.back().verdict != Verdict::kAccepted) return;
    ++forced;
    const Node &a = graph.nodes()[from], &b = graph.nodes()[to];
    EXPECT_LT((a.T_world_submap.translation() - b.T_world_submap.translation()).norm(), 30.0);
    ASSERT_TRUE(graph.remove(from, to));
  });
  EXPECT_GT(forced, 3U);
}

TEST(LoopGraph, ALoopIsNamedBySweepsOfTwoRunsThatAreNumberedAlike) {
  TestTown town(6);
  TestDrive driven = drive(town, rounds(40.0, 2), 0.1, 0.006, 6);
  const std::size_t half = driven.submaps.size() / 2;
  for (std::size_t i = half; i < driven.submaps.size(); ++i) {
    driven.submaps[i].sweep = driven.submaps[i - half].sweep;
    driven.submaps[i].before_sweep = driven.submaps[i - 1].sweep;
  }
  const Ran ran = run(driven);
  std::size_t into_second_run = 0;
  for (const Loop& loop : ran.graph.loops()) {
    if (loop.verdict != Verdict::kAccepted) continue;
    const auto found =
        ran.graph.in_force(driven.submaps[loop.from].sweep, driven.submaps[loop.to].sweep);
    const auto is_it = [&](const Loop& l) { return l.from == loop.from && l.to == loop.to; };
    EXPECT_TRUE(std::ranges::any_of(found, is_it)) << loop.from << " to " << loop.to;
    const auto reversed =
        ran.graph.in_force(driven.submaps[loop.to].sweep, driven.submaps[loop.from].sweep);
    EXPECT_FALSE(reversed.empty()) << loop.to << " to " << loop.from;
    into_second_run += loop.to >= half ? 1 : 0;
  }
  EXPECT_GT(into_second_run, 5U);
}

TEST(LoopGraph, TheSameSubmapsGiveTheSameBytes) {
  TestTown town(7);
  const TestDrive driven = drive(town, rounds(40.0, 2), 0.1, 0.006, 7);
  const Ran first = run(driven), second = run(driven);
  for (std::size_t i = 0; i < first.world.size(); ++i) {
    EXPECT_EQ(first.world[i].matrix(), second.world[i].matrix());
  }
}

TEST(LoopGraph, CorrectsPosesBetweenSubmapsWithoutAStep) {
  TestTown town(8);
  const TestDrive driven = drive(town, rounds(40.0, 2), 0.1, 0.006, 8);
  const Ran ran = run(driven);
  const Node& a = ran.graph.nodes()[10];
  const Node& b = ran.graph.nodes()[11];
  EXPECT_LT((ran.graph.corrected(a.instant_ns, a.T_map_submap).matrix() - a.T_world_submap.matrix())
                .norm(),
            1e-9);
  Pose before = ran.graph.corrected(a.instant_ns, a.T_map_submap);
  for (int k = 1; k <= 100; ++k) {
    const double share = k / 100.0;
    const Pose T_map_base =
        a.T_map_submap * exp_se3(share * log_se3(a.T_map_submap.inverse() * b.T_map_submap));
    const auto instant =
        a.instant_ns + static_cast<std::int64_t>(share * double(b.instant_ns - a.instant_ns));
    const Pose now = ran.graph.corrected(instant, T_map_base);
    EXPECT_LT((now.translation() - before.translation()).norm(), 0.2) << k;
    before = now;
  }
  EXPECT_LT((before.matrix() - b.T_world_submap.matrix()).norm(), 1e-6);
}

TEST(LoopGraph, ASubmapThatWasMissedIsAGapInTheChain) {
  TestTown town(9);
  TestDrive driven = drive(town, rounds(40.0, 2), 0.02, 0.001, 9);
  driven.submaps.erase(driven.submaps.begin() + 12);
  const Ran ran = run(driven);
  EXPECT_FALSE(ran.graph.nodes()[12].connected);
  EXPECT_TRUE(ran.graph.nodes()[13].connected);
  EXPECT_GE(ran.graph.loops_in_force(), 10U);
}

// In a merged map, or one that another drive extended, the first submap of a drive may have the
// number of the last one of the drive before.
TEST(LoopGraph, ADriveDoesNotGoOnWithTheNextOne) {
  TestTown town(9);
  TestDrive driven = drive(town, rounds(40.0, 1), 0.02, 0.001, 9);
  driven.submaps.resize(3);
  for (Submap& submap : driven.submaps) submap.sweep = 30;
  driven.submaps[1].before_sweep = driven.submaps[2].before_sweep = 30;
  const Ran ran = run(driven);
  EXPECT_TRUE(ran.graph.nodes()[0].connected);
  EXPECT_FALSE(ran.graph.nodes()[1].connected);
  EXPECT_FALSE(ran.graph.nodes()[2].connected);
}

}  // namespace
}  // namespace zloam::graph
