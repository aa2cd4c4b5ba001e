#include "mapping/wall_map.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <numbers>
#include <queue>
#include <tuple>
#include <utility>

namespace zloam::mapping {
namespace {

// A column of this edge contains a wall if its points reach up by kWall_m without a gap above
// kGap_m, which is the spacing of a sensor's rings.
constexpr float kColumn_m = 0.5F, kGap_m = 1.0F, kWall_m = 0.6F;
// Cell sizes of the search, which are also its steps. The one used is chosen such that a step of
// the heading moves a wall at median range by one or two cells. Grids of more than kMostCells are
// left out; a map that is too large for all of them has one of the next larger cells.
constexpr std::array<float, 3> kCells_m = {0.25F, 0.5F, 1.0F};
constexpr double kMostCells = 1e7;
constexpr int kTurns = 128;
constexpr double kTurn_rad = 2.0 * std::numbers::pi / kTurns;
constexpr float kCellsOfTurn = 1.5F;
constexpr float kFarthest_m = 40.0F;
constexpr std::size_t kMostWalls = 200, kFewestWalls = 20;
constexpr int kLevels = 7;
// Score of a cell with a wall and of its neighbours: the right place lies between places of the
// grid.
constexpr std::uint8_t kHit = 2, kBeside = 1;
// Minimum score of a place as a share of the best score (kWorth), and as a share of the highest
// possible score (kLeast), below which it is a different place.
constexpr double kWorth = 0.8, kLeast = 0.4;
constexpr std::size_t kMostNodes = 2'000'000;
// Resolution of the heights that are compared.
constexpr float kHeight_m = 0.25F;
constexpr std::size_t kMostVoters = 1000;
// Range limits of the walls in view. A return farther behind a wall than kBehind_m sees through it.
constexpr float kInView_m = 20.0F, kTooNear_m = 1.0F, kBehind_m = 0.7F;

Eigen::Vector2i cell_of(const Eigen::Vector2f& at_m, float cell_m) {
  return (at_m / cell_m).array().floor().cast<int>();
}

/// Cell sizes for a map of this size, ascending; at least one.
std::vector<float> cell_sizes_of(const Eigen::Vector2f& size_m) {
  const auto is_small = [&](float cell_m) {
    const Eigen::Vector2d cells = (size_m / cell_m).cast<double>();
    return cells.x() * cells.y() <= kMostCells;
  };
  std::vector<float> sizes_m;
  for (const float cell_m : kCells_m) {
    if (is_small(cell_m)) sizes_m.push_back(cell_m);
  }
  float cell_m = kCells_m.back();
  while (sizes_m.empty()) {
    cell_m *= 2.0F;
    if (is_small(cell_m)) sizes_m.push_back(cell_m);
  }
  return sizes_m;
}

/// Whether a column of points, in ascending height, contains a wall.
template <typename At>
bool is_wall(std::span<const At> column) {
  float foot_m = column.front().z;
  for (std::size_t i = 1; i < column.size(); ++i) {
    if (column[i].z - column[i - 1].z > kGap_m) foot_m = column[i].z;
    if (column[i].z - foot_m >= kWall_m) return true;
  }
  return false;
}

/// The points that belong to walls.
std::vector<Eigen::Vector3f> walls_of(std::span<const Eigen::Vector3f> points) {
  struct At {
    int x, y;
    float z;
    std::uint32_t index;
    auto operator<=>(const At&) const = default;
  };
  std::vector<At> sorted;
  sorted.reserve(points.size());
  for (const Eigen::Vector3f& p : points) {
    const Eigen::Vector2i cell = cell_of(p.head<2>(), kColumn_m);
    sorted.push_back({cell.x(), cell.y(), p.z(), static_cast<std::uint32_t>(sorted.size())});
  }
  std::sort(sorted.begin(), sorted.end());
  std::vector<Eigen::Vector3f> walls;
  for (auto begin = sorted.begin(); begin != sorted.end();) {
    const auto end = std::find_if(begin, sorted.end(),
                                  [&](const At& a) { return a.x != begin->x || a.y != begin->y; });
    if (is_wall(std::span<const At>(begin, end))) {
      for (auto at = begin; at != end; ++at) walls.push_back(points[at->index]);
    }
    begin = end;
  }
  return walls;
}

bool is_next_to(int turn_a, int turn_b) {
  const int apart = std::abs(turn_a - turn_b);
  return std::min(apart, kTurns - apart) <= 2;
}

}  // namespace

WallMap::WallMap(std::span<const Eigen::Vector3f> points) {
  if (points.empty()) return;
  Eigen::Vector2f low = points.front().head<2>(), high = low;
  for (const Eigen::Vector3f& p : points) {
    low = low.cwiseMin(p.head<2>());
    high = high.cwiseMax(p.head<2>());
  }
  origin_ = low;
  const std::vector<Eigen::Vector3f> wall_points = walls_of(points);
  std::vector<Eigen::Vector2f> walls;
  walls.reserve(wall_points.size());
  for (const Eigen::Vector3f& w : wall_points) walls.emplace_back(w.head<2>() - origin_);
  for (const float cell_m : cell_sizes_of(high - low)) {
    pyramids_.push_back(pyramid_of(walls, high - low, cell_m));
  }
  keep_heights(points);
  for (const Eigen::Vector3f& w : wall_points) {
    const Eigen::Vector2i cell = cell_of(w.head<2>() - origin_, kColumn_m);
    wall_points_.emplace_back(ColumnIndex{cell.y(), cell.x()}, w);
  }
  std::stable_sort(wall_points_.begin(), wall_points_.end(),
                   [](const auto& a, const auto& b) { return a.first < b.first; });
}

double WallMap::seen_through(const SweepView& view, const Pose& T_map_lidar) const {
  const Eigen::Isometry3f T_lidar_map = T_map_lidar.inverse().cast<float>();
  const Eigen::Vector2f here = T_map_lidar.translation().head<2>().cast<float>() - origin_;
  const Eigen::Vector2i low = cell_of(here - Eigen::Vector2f::Constant(kInView_m), kColumn_m);
  const Eigen::Vector2i high = cell_of(here + Eigen::Vector2f::Constant(kInView_m), kColumn_m);
  std::size_t through = 0, met = 0;
  for (int y = std::max(0, low.y()); y <= high.y() && y < height_; ++y) {
    const ColumnIndex first{y, std::max(0, low.x())}, last{y, high.x()};
    auto at =
        std::lower_bound(wall_points_.begin(), wall_points_.end(), first,
                         [](const auto& a, const ColumnIndex& column) { return a.first < column; });
    for (; at != wall_points_.end() && at->first <= last; ++at) {
      const Eigen::Vector3f p = T_lidar_map * at->second;
      const float range_m = p.norm();
      if (range_m > kInView_m || range_m < kTooNear_m) continue;
      const float seen_m = view.nearest_m(p / range_m);
      if (seen_m > range_m + kBehind_m) {
        ++through;
      } else if (seen_m > range_m - kBehind_m) {
        ++met;
      }
    }
  }
  return static_cast<double>(through) /
         static_cast<double>(std::max<std::size_t>(through + met, 1));
}

WallMap::Pyramid WallMap::pyramid_of(std::span<const Eigen::Vector2f> walls,
                                     const Eigen::Vector2f& size_m, float cell_m) {
  const Eigen::Vector2i last = cell_of(size_m, cell_m);
  Level finest{last.x() + 1, last.y() + 1, {}};
  finest.values.resize(static_cast<std::size_t>(finest.width) *
                       static_cast<std::size_t>(finest.height));
  for (const Eigen::Vector2f& wall : walls) {
    const Eigen::Vector2i at = cell_of(wall, cell_m);
    for (int y = std::max(0, at.y() - 1); y <= std::min(last.y(), at.y() + 1); ++y) {
      for (int x = std::max(0, at.x() - 1); x <= std::min(last.x(), at.x() + 1); ++x) {
        std::uint8_t& value =
            finest.values[static_cast<std::size_t>(y) * static_cast<std::size_t>(finest.width) +
                          static_cast<std::size_t>(x)];
        value = std::max(value, x == at.x() && y == at.y() ? kHit : kBeside);
      }
    }
  }
  Pyramid pyramid{cell_m, {}};
  pyramid.levels.push_back(std::move(finest));
  for (int l = 1; l < kLevels; ++l) {
    // A square of 2^l cells consists of four squares of half its edge.
    const Level& fine = pyramid.levels.back();
    const int half = 1 << (l - 1);
    Level coarse{fine.width + half, fine.height + half, {}};
    coarse.values.reserve(static_cast<std::size_t>(coarse.width) *
                          static_cast<std::size_t>(coarse.height));
    const auto value = [&](int x, int y) -> std::uint8_t {
      if (x < 0 || y < 0 || x >= fine.width || y >= fine.height) return 0;
      return fine.values[static_cast<std::size_t>(y) * static_cast<std::size_t>(fine.width) +
                         static_cast<std::size_t>(x)];
    };
    for (int y = 0; y < coarse.height; ++y) {
      for (int x = 0; x < coarse.width; ++x) {
        coarse.values.push_back(std::max(
            {value(x, y), value(x - half, y), value(x, y - half), value(x - half, y - half)}));
      }
    }
    pyramid.levels.push_back(std::move(coarse));
  }
  return pyramid;
}

void WallMap::keep_heights(std::span<const Eigen::Vector3f> points) {
  for (const Eigen::Vector3f& p : points) {
    const Eigen::Vector2i cell = cell_of(p.head<2>() - origin_, kColumn_m);
    width_ = std::max(width_, cell.x() + 1);
    height_ = std::max(height_, cell.y() + 1);
  }
  columns_.reserve(points.size());
  for (const Eigen::Vector3f& p : points) {
    const Eigen::Vector2i cell = cell_of(p.head<2>() - origin_, kColumn_m);
    columns_.push_back(
        {{cell.y(), cell.x()}, static_cast<std::int32_t>(std::floor(p.z() / kHeight_m))});
  }
  std::sort(columns_.begin(), columns_.end());
  columns_.erase(std::unique(columns_.begin(), columns_.end()), columns_.end());
}

// Upper bound of the score of the cells shifted by (x, y), and by up to `first` more along each
// axis.
std::uint32_t WallMap::score(const Level& level, const Cells& cells, int x, int y, int first) {
  std::uint32_t sum = 0;
  const auto width = static_cast<std::uint32_t>(level.width);
  const auto height = static_cast<std::uint32_t>(level.height);
  for (const Eigen::Vector2i& c : cells) {
    const auto at_x = static_cast<std::uint32_t>(c.x() + x + first);
    const auto at_y = static_cast<std::uint32_t>(c.y() + y + first);
    if (at_x < width && at_y < height) sum += level.values[std::size_t{at_y} * width + at_x];
  }
  return sum;
}

std::vector<WallMap::Node> WallMap::search(const Pyramid& pyramid, const std::vector<Cells>& turned,
                                           std::size_t most, double least_share) {
  const auto worse = [](const Node& a, const Node& b) {
    return std::tie(a.score, b.level, b.turn, b.x, b.y) <
           std::tie(b.score, a.level, a.turn, a.x, a.y);
  };
  std::priority_queue<Node, std::vector<Node>, decltype(worse)> open(worse);
  const double full = kHit * static_cast<double>(turned.front().size());
  double least = std::max(kLeast, least_share) * full;
  std::size_t nodes = 0;
  const auto add = [&](int turn, int level, int x, int y) {
    ++nodes;
    const std::uint32_t s = score(pyramid.levels[static_cast<std::size_t>(level)],
                                  turned[static_cast<std::size_t>(turn)], x, y, (1 << level) - 1);
    if (s >= least) {
      open.push({s, x, y, static_cast<std::int16_t>(turn), static_cast<std::int8_t>(level)});
    }
  };
  const Level& finest = pyramid.levels.front();
  const int top = kLevels - 1;
  for (int turn = 0; turn < kTurns; ++turn) {
    for (int y = 0; y < finest.height; y += 1 << top) {
      for (int x = 0; x < finest.width; x += 1 << top) add(turn, top, x, y);
    }
  }
  std::vector<Node> best;
  while (!open.empty() && best.size() < most && nodes < kMostNodes) {
    const Node node = open.top();
    open.pop();
    if (node.score < least) break;
    if (node.level > 0) {
      const int half = 1 << (node.level - 1);
      for (const int y : {node.y, node.y + half}) {
        for (const int x : {node.x, node.x + half}) add(node.turn, node.level - 1, x, y);
      }
      continue;
    }
    const bool known = std::any_of(best.begin(), best.end(), [&](const Node& b) {
      return std::abs(b.x - node.x) <= 2 && std::abs(b.y - node.y) <= 2 &&
             is_next_to(b.turn, node.turn);
    });
    if (known) continue;
    if (best.empty() && least_share <= 0.0) least = std::max(least, kWorth * node.score);
    best.push_back(node);
  }
  return best;
}

// Each point votes for the heights at which it would coincide with a point of its column of the
// map.
double WallMap::height_of(std::span<const Eigen::Vector3f> points_level, const Pose& place) const {
  std::map<std::int32_t, std::uint32_t> votes;
  const Eigen::Isometry3f T = place.cast<float>();
  const std::size_t stride = std::max<std::size_t>(1, points_level.size() / kMostVoters);
  for (std::size_t i = 0; i < points_level.size(); i += stride) {
    const Eigen::Vector3f p = T * points_level[i];
    const Eigen::Vector2i cell = cell_of(p.head<2>() - origin_, kColumn_m);
    if ((cell.array() < 0).any() || cell.x() >= width_ || cell.y() >= height_) continue;
    const auto height = static_cast<std::int32_t>(std::floor(p.z() / kHeight_m));
    const Column lowest{{cell.y(), cell.x()}, std::numeric_limits<std::int32_t>::min()};
    for (auto column = std::lower_bound(columns_.begin(), columns_.end(), lowest);
         column != columns_.end() && column->cell == lowest.cell; ++column) {
      ++votes[column->height - height];
    }
  }
  const auto count = [&](std::int32_t height) {
    const auto found = votes.find(height);
    return found == votes.end() ? 0U : found->second;
  };
  std::int32_t best = 0;
  std::uint32_t most = 0;
  for (const auto& [height, own] : votes) {
    const std::uint32_t sum = 2 * own + count(height - 1) + count(height + 1);
    if (sum <= most) continue;
    most = sum;
    best = height;
  }
  return static_cast<double>(kHeight_m) * best;
}

Surroundings::Surroundings(std::span<const Eigen::Vector3f> points_level) {
  for (const Eigen::Vector3f& p : points_level) {
    if (p.head<2>().norm() < kFarthest_m) near_.push_back(p);
  }
  const std::vector<Eigen::Vector3f> walls = walls_of(near_);
  if (walls.size() < kFewestWalls) return;
  const double stride = std::max(1.0, static_cast<double>(walls.size()) / kMostWalls);
  std::vector<float> ranges_m;
  for (double i = 0.0; i < static_cast<double>(walls.size()); i += stride) {
    walls_.emplace_back(walls[static_cast<std::size_t>(i)].head<2>());
    ranges_m.push_back(walls_.back().norm());
  }
  const auto middle = ranges_m.begin() + static_cast<std::ptrdiff_t>(ranges_m.size() / 2);
  std::nth_element(ranges_m.begin(), middle, ranges_m.end());
  range_m_ = *middle;
}

const WallMap::Pyramid& WallMap::pyramid_for(const Surroundings& around) const {
  const float wanted_m = static_cast<float>(kTurn_rad) * around.range_m_ / kCellsOfTurn;
  const Pyramid* pyramid = &pyramids_.front();
  for (const Pyramid& p : pyramids_) {
    if (p.cell_m <= wanted_m) pyramid = &p;
  }
  return *pyramid;
}

WallMap::Cells WallMap::turned_by(int turn, const Surroundings& around, float cell_m) {
  const Eigen::Rotation2Df R(static_cast<float>(turn * kTurn_rad));
  Cells cells;
  for (const Eigen::Vector2f& wall : around.walls_) cells.push_back(cell_of(R * wall, cell_m));
  return cells;
}

std::vector<Pose> WallMap::likely_places(const Surroundings& around, std::size_t most,
                                         double least_share) const {
  if (pyramids_.empty() || around.walls_.empty()) return {};
  const Pyramid& pyramid = pyramid_for(around);
  std::vector<Cells> turned;
  turned.reserve(kTurns);
  for (int turn = 0; turn < kTurns; ++turn) {
    turned.push_back(turned_by(turn, around, pyramid.cell_m));
  }
  std::vector<Pose> places;
  for (const Node& node : search(pyramid, turned, most, least_share)) {
    Pose place = Pose::Identity();
    place.linear() =
        Eigen::AngleAxisd(node.turn * kTurn_rad, Eigen::Vector3d::UnitZ()).toRotationMatrix();
    const Eigen::Vector2i cell(node.x, node.y);
    place.translation().head<2>() = (origin_ + pyramid.cell_m * cell.cast<float>()).cast<double>();
    place.translation().z() = height_of(around.near_, place);
    places.push_back(place);
  }
  return places;
}

double WallMap::share_at(const Surroundings& around, const Pose& T_map_level) const {
  if (pyramids_.empty() || around.walls_.empty()) return 0.0;
  const Pyramid& pyramid = pyramid_for(around);
  const Eigen::Matrix3d& R = T_map_level.linear();
  const double yaw_rad = std::atan2(R(1, 0), R(0, 0));
  const auto turn = static_cast<int>(std::lround(yaw_rad / kTurn_rad));
  const Eigen::Vector2f at = T_map_level.translation().head<2>().cast<float>() - origin_;
  const Eigen::Vector2i cell = (at / pyramid.cell_m).array().round().cast<int>();
  const Cells cells = turned_by(turn, around, pyramid.cell_m);
  return score(pyramid.levels.front(), cells, cell.x(), cell.y(), 0) /
         (static_cast<double>(kHit) * static_cast<double>(cells.size()));
}

}  // namespace zloam::mapping
