// What is sent of a map, checked with a viewer that reassembles it.

#include "preview/preview.hpp"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <deque>
#include <functional>
#include <map>
#include <random>
#include <set>
#include <vector>

#include "preview/config.hpp"

namespace zloam::preview {
namespace {

constexpr double kEdge_m = 50.0;
constexpr double kBlock_m = 12.5;
constexpr std::size_t kBudget_bytes = 9'000;
const Eigen::Vector3d kOrigin = Eigen::Vector3d::Zero();

using Points = std::vector<MapPoint>;
using Cells = std::set<std::array<int, 3>>;

/// Keeps the newest piece of each block, decoded as the schema defines.
class Viewer {
 public:
  struct Shown {
    int depth = 0;
    Cells cells;
  };

  void take(const std::vector<Piece>& pieces) {
    for (const Piece& piece : pieces) {
      const CubeIndex& b = piece.block;
      std::vector<std::array<int, 3>> nodes;
      if (!piece.octree.empty()) nodes.push_back({b.i, b.j, b.k});
      std::size_t at = 0;
      for (int level = 0; level < piece.depth; ++level) {
        std::vector<std::array<int, 3>> halves;
        for (const auto& n : nodes) {
          const unsigned byte = piece.octree.at(at++);
          for (int bit = 0; bit < 8; ++bit) {
            if ((byte >> bit & 1U) == 0) continue;
            halves.push_back(
                {2 * n[0] + (bit & 1), 2 * n[1] + (bit >> 1 & 1), 2 * n[2] + (bit >> 2)});
          }
        }
        nodes = std::move(halves);
      }
      EXPECT_EQ(at, piece.octree.size());
      shown[b] = {piece.depth, {nodes.begin(), nodes.end()}};
    }
  }

  std::map<CubeIndex, Shown> shown;
};

CubeIndex index_of(const MapPoint& p, double edge_m) {
  return {static_cast<int>(std::floor(p.x / edge_m)), static_cast<int>(std::floor(p.y / edge_m)),
          static_cast<int>(std::floor(p.z / edge_m))};
}

/// Cells of a block after this many halvings, computed directly from the points.
Cells cells_in(const Points& points, const CubeIndex& block, int depth) {
  Cells cells;
  for (const MapPoint& p : points) {
    if (index_of(p, kBlock_m) != block) continue;
    const CubeIndex cell = index_of(p, std::ldexp(kBlock_m, -depth));
    cells.insert({cell.i, cell.j, cell.k});
  }
  return cells;
}

void put_all(Preview& preview, const Points& points, std::uint64_t version = 1, int layer = 1) {
  std::map<CubeIndex, Points> cubes;
  for (const MapPoint& p : points) cubes[index_of(p, kEdge_m)].push_back(p);
  for (const auto& [cube, own] : cubes) preview.put(cube, layer, kEdge_m, {1, version}, own);
}

/// A street between two positions on x: floor and two walls, points every 0.25 m with some noise.
Points street(double from_m, double to_m, double every_m = 0.25) {
  std::mt19937 random(3);
  std::normal_distribution<double> noise(0.0, 0.02);
  Points points;
  const auto add = [&](double x, double y, double z) {
    points.push_back({static_cast<float>(x + noise(random)), static_cast<float>(y + noise(random)),
                      static_cast<float>(z + noise(random)), 0.0F});
  };
  for (double x = from_m; x < to_m; x += every_m) {
    for (double y = -8.0; y < 8.0; y += every_m) add(x, y, -1.8);
    for (double z = -1.5; z < 8.0; z += every_m) {
      add(x, -8.0, z);
      add(x, 8.0, z);
    }
  }
  return points;
}

std::size_t bytes_of(const std::vector<Piece>& pieces) {
  std::size_t bytes = 0;
  for (const Piece& piece : pieces) bytes += piece.bytes();
  return bytes;
}

TEST(Preview, ShowsTheCellsOfThePoints) {
  const Points points = street(-100.0, 300.0);
  Preview preview;
  put_all(preview, points);
  Viewer viewer;
  for (int call = 0; call < 400; ++call) viewer.take(preview.take(kBudget_bytes, kOrigin));
  std::set<CubeIndex> blocks;
  for (const MapPoint& p : points) blocks.insert(index_of(p, kBlock_m));
  EXPECT_EQ(preview.blocks(), blocks.size());
  ASSERT_EQ(viewer.shown.size(), blocks.size());
  for (const auto& [block, shown] : viewer.shown) {
    EXPECT_EQ(shown.cells, cells_in(points, block, shown.depth));
  }
}

TEST(Preview, BothLayersOfACubeAreShown) {
  const Points planes = street(0.0, 20.0), edges = {{10.1F, 3.0F, 4.0F, 0.0F}};
  Points both = planes;
  both.insert(both.end(), edges.begin(), edges.end());
  Preview preview;
  put_all(preview, planes, 1, 1);
  put_all(preview, edges, 1, 0);
  Viewer viewer;
  for (int call = 0; call < 40; ++call) viewer.take(preview.take(kBudget_bytes, kOrigin));
  std::set<CubeIndex> blocks;
  for (const MapPoint& p : both) blocks.insert(index_of(p, kBlock_m));
  ASSERT_EQ(viewer.shown.size(), blocks.size());
  for (const auto& [block, shown] : viewer.shown) {
    EXPECT_EQ(shown.cells, cells_in(both, block, shown.depth));
  }
}

TEST(Preview, CellsGrowWithTheDistance) {
  Preview preview;
  put_all(preview, street(0.5, 499.5));
  Viewer viewer;
  for (int call = 0; call < 400; ++call) viewer.take(preview.take(kBudget_bytes, kOrigin));
  std::map<int, double> cell_m;
  for (const auto& [block, shown] : viewer.shown) {
    // Only blocks on the street's axis, whose distance is along x.
    if (block.j != 0 || block.k != -1) continue;
    cell_m[block.i] = std::ldexp(kBlock_m, -shown.depth);
  }
  ASSERT_EQ(cell_m.size(), 40U);
  // Blocks of 12.5 m: up to 25, 50, 100 m, and farther.
  EXPECT_DOUBLE_EQ(cell_m[0], 0.1953125);
  EXPECT_DOUBLE_EQ(cell_m[2], 0.1953125);
  EXPECT_DOUBLE_EQ(cell_m[3], 0.390625);
  EXPECT_DOUBLE_EQ(cell_m[5], 0.78125);
  EXPECT_DOUBLE_EQ(cell_m[9], 1.5625);
  EXPECT_DOUBLE_EQ(cell_m[39], 1.5625);
}

TEST(Preview, FollowsTheRobot) {
  Preview preview;
  put_all(preview, street(0.0, 300.0));
  Viewer viewer;
  for (int call = 0; call < 200; ++call) viewer.take(preview.take(kBudget_bytes, kOrigin));
  const CubeIndex far{20, 0, -1};
  EXPECT_EQ(viewer.shown[far].depth, 3);
  for (int call = 0; call < 20; ++call) viewer.take(preview.take(kBudget_bytes, {255.0, 0.0, 0.0}));
  EXPECT_EQ(viewer.shown[far].depth, 6);
}

TEST(Preview, NothingIsLargerThanTheBudget) {
  std::mt19937 random(9);
  std::uniform_int_distribution<std::size_t> any(100, 12'000);
  Preview preview;
  put_all(preview, street(-50.0, 150.0, 0.15));
  for (int call = 0; call < 300; ++call) {
    const std::size_t budget = any(random);
    EXPECT_LE(bytes_of(preview.take(budget, kOrigin)), budget);
  }
}

TEST(Preview, ABlockThatFitsNoMessageComesWithLargerCells) {
  // All 64^3 cells of a block.
  Points full;
  for (int x = 0; x < 64; ++x) {
    for (int y = 0; y < 64; ++y) {
      for (int z = 0; z < 64; ++z) {
        const auto at = [](int n) { return static_cast<float>((n + 0.5) * kBlock_m / 64); };
        full.push_back({at(x), at(y), at(z), 0.0F});
      }
    }
  }
  Preview preview;
  put_all(preview, full);
  Viewer viewer;
  for (int call = 0; call < 4; ++call) viewer.take(preview.take(kBudget_bytes, kOrigin));
  // 1 + 8 + ... + 8^4 bytes; one more level would add 8^5, 37449 in all.
  ASSERT_EQ(viewer.shown.size(), 1U);
  EXPECT_EQ(viewer.shown.begin()->second.depth, 5);
  EXPECT_EQ(viewer.shown.begin()->second.cells.size(), 32768U);
  // It is not tried again and again.
  EXPECT_TRUE(preview.take(kBudget_bytes, kOrigin).empty());
}

/// Number of calls until a viewer that begins now has the whole map.
int calls_until_whole(Preview& preview, const std::function<void(int)>& change = {}) {
  Viewer late;
  int calls = 0;
  while (late.shown.size() < preview.blocks() && calls < 10'000) {
    if (change) change(calls);
    late.take(preview.take(kBudget_bytes, kOrigin));
    ++calls;
  }
  return calls;
}

TEST(Preview, WhoJoinsLateHasTheWholeMapAfterOneRound) {
  Preview preview;
  put_all(preview, street(0.0, 2000.0));
  for (int call = 0; call < 400; ++call) preview.take(kBudget_bytes, kOrigin);
  // An unchanged block is sent again after kRestCalls, or after one round if that takes longer;
  // here the round is shorter.
  EXPECT_LE(calls_until_whole(preview), static_cast<int>(kRestCalls) + 1);
}

TEST(Preview, ChangesNearTheRobotDoNotHoldUpTheRound) {
  Preview preview;
  put_all(preview, street(0.0, 2000.0));
  for (int call = 0; call < 400; ++call) preview.take(kBudget_bytes, kOrigin);
  // Each call changes all blocks near the robot: more than all messages can hold.
  const std::array<Points, 2> near = {street(0.0, 49.0, 0.25), street(0.0, 49.0, 0.31)};
  const auto change = [&](int call) {
    const auto version = static_cast<std::uint64_t>(10 + call);
    put_all(preview, near.at(static_cast<std::size_t>(call % 2)), version);
  };
  EXPECT_LE(calls_until_whole(preview, change), 2 * static_cast<int>(kRestCalls));
}

TEST(Preview, AChangeIsSentAtOnce) {
  Points points = street(0.0, 400.0);
  Preview preview;
  put_all(preview, points);
  std::vector<Piece> pieces;
  // Continue until no block is due and none is old enough to be sent again.
  for (int call = 0; call < 400 || !pieces.empty(); ++call) {
    pieces = preview.take(kBudget_bytes, kOrigin);
  }
  points.push_back({5.0F, 0.0F, 3.0F, 0.0F});
  put_all(preview, points, 2);
  pieces = preview.take(kBudget_bytes, kOrigin);
  ASSERT_FALSE(pieces.empty());
  EXPECT_EQ(pieces.front().block, (CubeIndex{0, 0, 0}));
  // Far away, a point in a cell that is already shown changes nothing visible.
  for (int call = 0; call < 400 || !pieces.empty(); ++call) {
    pieces = preview.take(kBudget_bytes, kOrigin);
  }
  points.push_back({390.1F, 0.0F, -1.7F, 0.0F});
  put_all(preview, points, 3);
  EXPECT_TRUE(preview.take(kBudget_bytes, kOrigin).empty());
}

TEST(Preview, TheWholeMapComesWithLargeCellsFirst) {
  Preview preview;
  put_all(preview, street(-300.0, 300.0, 0.15));
  const int first = calls_until_whole(preview);
  std::size_t bytes = 0;
  for (int call = 0; call < 400; ++call) preview.take(kBudget_bytes, kOrigin);
  for (std::uint64_t call = 0; call < kRestCalls; ++call) {
    bytes += bytes_of(preview.take(kBudget_bytes, kOrigin));
  }
  // Less than half of the time that the cells of the intended size would take.
  EXPECT_LT(2 * first, static_cast<int>(bytes / kBudget_bytes));
  // After that every block counts as unsent, and the whole map is sent as fast again.
  preview.forget_sent();
  EXPECT_LE(calls_until_whole(preview), first + 1);
}

TEST(Preview, AMapAtRestTakesAPartOfTheRate) {
  Preview preview;
  put_all(preview, street(0.0, 50.0));
  for (int call = 0; call < 200; ++call) preview.take(kBudget_bytes, kOrigin);
  std::multiset<CubeIndex> came;
  std::size_t bytes = 0;
  for (std::uint64_t call = 0; call < kRestCalls; ++call) {
    for (const Piece& piece : preview.take(kBudget_bytes, kOrigin)) {
      came.insert(piece.block);
      bytes += piece.bytes();
    }
  }
  // Each block is sent once.
  EXPECT_EQ(came.size(), preview.blocks());
  EXPECT_EQ(std::set<CubeIndex>(came.begin(), came.end()).size(), preview.blocks());
  EXPECT_LT(bytes, kRestCalls * kBudget_bytes / 4);
}

TEST(Preview, AnUpdateReplaces) {
  Preview preview;
  const Points before = {{1.0F, 1.0F, 1.0F, 0.0F}, {30.0F, 1.0F, 1.0F, 0.0F}};
  const Points after = {{2.0F, 2.0F, 2.0F, 0.0F}};
  EXPECT_TRUE(preview.put({0, 0, 0}, 1, kEdge_m, {1, 5}, before));
  Viewer viewer;
  for (int call = 0; call < 4; ++call) viewer.take(preview.take(kBudget_bytes, kOrigin));
  EXPECT_EQ(viewer.shown.size(), 2U);
  EXPECT_FALSE(preview.put({0, 0, 0}, 1, kEdge_m, {1, 5}, after)) << "the same version";
  EXPECT_FALSE(preview.put({0, 0, 0}, 1, kEdge_m, {1, 4}, after)) << "an older one";
  EXPECT_TRUE(preview.put({0, 0, 0}, 1, kEdge_m, {2, 1}, after)) << "of who came after";
  EXPECT_EQ(preview.blocks(), 1U);
  viewer.take(preview.take(kBudget_bytes, kOrigin));
  const CubeIndex first{0, 0, 0}, emptied{2, 0, 0};
  EXPECT_EQ(viewer.shown[first].cells, cells_in(after, first, viewer.shown[first].depth));
  EXPECT_TRUE(viewer.shown[emptied].cells.empty());
}

TEST(Preview, AnotherMapHasNothingOfTheOneBefore) {
  Preview preview;
  put_all(preview, street(0.0, 60.0), 7);
  preview.clear();
  EXPECT_EQ(preview.blocks(), 0U);
  EXPECT_TRUE(preview.take(kBudget_bytes, kOrigin).empty());
  // Versions start again with another map.
  EXPECT_TRUE(preview.put({0, 0, 0}, 1, kEdge_m, {1, 1}, Points{{1.0F, 1.0F, 1.0F, 0.0F}}));
  EXPECT_EQ(preview.take(kBudget_bytes, kOrigin).size(), 1U);
}

TEST(Preview, WhatIsNoCubeIsRefused) {
  Preview preview;
  const Points one = {{1.0F, 1.0F, 1.0F, 0.0F}};
  EXPECT_FALSE(preview.put({0, 0, 0}, 1, 1e-30, {1, 1}, one));
  EXPECT_FALSE(preview.put({0, 0, 0}, 1, 1e30, {1, 1}, one));
  EXPECT_FALSE(preview.put({2'000'000'000, 0, 0}, 1, kEdge_m, {1, 1}, one));
  EXPECT_FALSE(preview.put({0, 0, 0}, 2, kEdge_m, {1, 1}, one));
  EXPECT_EQ(preview.blocks(), 0U);
}

TEST(Pace, NoSecondHasMoreThanTheRate) {
  // A caller that is late at times, and then calls several times in a row.
  std::mt19937 random(4);
  std::uniform_int_distribution<std::int64_t> step_ns(1'000'000, 400'000'000);
  Pace pace(kLeastPeriod_ns);
  std::deque<std::int64_t> sent_ns;
  std::int64_t now_ns = 0;
  std::size_t most = 0;
  for (int n = 0; n < 5'000; ++n) {
    now_ns += n % 7 == 0 ? step_ns(random) : 1'000'000 + step_ns(random) / 40;
    if (!pace.may_send(now_ns)) continue;
    sent_ns.push_back(now_ns);
    while (now_ns - sent_ns.front() >= 1'000'000'000) sent_ns.pop_front();
    most = std::max(most, sent_ns.size());
  }
  EXPECT_EQ(most, kMost_messages_per_s);
  EXPECT_LE(most * kMessage_bytes, kMost_bytes_per_s);
}

}  // namespace
}  // namespace zloam::preview
