// Worlds town and town_later: a drive of more than three kilometres through a grid of streets, on
// the right side of each. Crossings are passed several times, streets in both directions. A week
// later (town_later) the houses are the same, other cars are parked, and one street has a new wall.

#include <algorithm>
#include <array>
#include <queue>
#include <stdexcept>

#include "simulator/scenes.hpp"
#include "simulator/streets.hpp"

namespace zloam::simulator {
namespace {

using Eigen::Vector2d;

constexpr int kColumns = 5, kRows = 4;
constexpr double kColumnM = 78.0, kRowM = 66.0;
// Distance from a crossing to the first house.
constexpr double kCrossingM = 26.0;
constexpr double kLeastWayM = 3200.0;
constexpr double kLaneM = 1.0;
constexpr int kNowhere = -1;

Vector2d place_of(int crossing) {
  return {kColumnM * (crossing % kColumns), kRowM * (crossing / kColumns)};
}

std::vector<int> neighbours(int crossing) {
  const int column = crossing % kColumns, row = crossing / kColumns;
  std::vector<int> out;
  if (column > 0) out.push_back(crossing - 1);
  if (column + 1 < kColumns) out.push_back(crossing + 1);
  if (row > 0) out.push_back(crossing - kColumns);
  if (row + 1 < kRows) out.push_back(crossing + kColumns);
  return out;
}

double way_between(int a, int b) { return (place_of(a) - place_of(b)).norm(); }

/// The shortest way from b, when coming from a, that ends with `last` and then `first`, without
/// U-turns. Returns the crossings after b, without `last` and `first`.
std::vector<int> way_back(int a, int b, int last, int first) {
  constexpr std::size_t kAll = kColumns * kRows;
  std::array<std::array<int, kAll>, kAll> before;  // [at][from]: the crossing before `from`
  for (auto& row : before) row.fill(kNowhere);
  std::queue<std::pair<int, int>> open;
  open.emplace(a, b);
  while (!open.empty()) {
    const auto [from, at] = open.front();
    open.pop();
    if (at == last && from != first) {
      std::vector<int> way;
      for (int x = from, y = at; !(x == a && y == b);) {
        way.push_back(y);
        const int earlier = before[static_cast<std::size_t>(y)][static_cast<std::size_t>(x)];
        y = x;
        x = earlier;
      }
      std::reverse(way.begin(), way.end());
      way.pop_back();
      return way;
    }
    for (const int next : neighbours(at)) {
      int& known = before[static_cast<std::size_t>(next)][static_cast<std::size_t>(at)];
      if (next == from || known != kNowhere || (at == a && next == b)) continue;
      known = from;
      open.emplace(at, next);
    }
  }
  throw std::logic_error("town: no way back");
}

/// The crossings in the order of the drive; the last one leads back to the first.
std::vector<int> round_trip(Random& random) {
  const int first = kColumns + 1, second = kColumns + 2;
  std::vector<int> way = {first, second};
  double length_m = way_between(first, second);
  while (length_m < kLeastWayM || way.back() == first) {
    const int from = way[way.size() - 2], at = way.back();
    std::vector<int> choices = neighbours(at);
    std::erase(choices, from);
    const auto choice =
        static_cast<std::size_t>(random.uniform(0.0, static_cast<double>(choices.size())));
    way.push_back(choices[std::min(choice, choices.size() - 1)]);
    length_m += way_between(at, way.back());
  }
  const std::vector<int> back = way_back(way[way.size() - 2], way.back(), first, second);
  way.insert(way.end(), back.begin(), back.end());
  return way;
}

Vector2d right_of(const Vector2d& along) { return {along.y(), -along.x()}; }

/// The path on the right side of each street; starts in the middle of the first street.
Path lane(const std::vector<int>& crossings) {
  const std::size_t count = crossings.size();
  const auto direction = [&](std::size_t i) -> Vector2d {
    return (place_of(crossings[(i + 1) % count]) - place_of(crossings[i % count])).normalized();
  };
  Polyline way = {0.5 * (place_of(crossings[0]) + place_of(crossings[1])) +
                  kLaneM * right_of(direction(0))};
  for (std::size_t i = 1; i <= count; ++i) {
    const Vector2d in = direction(i - 1), out = direction(i);
    if (in.dot(out) > 0.9) continue;
    way.push_back(place_of(crossings[i % count]) + kLaneM * (right_of(in) + right_of(out)));
  }
  return smooth_path(way, 9.0, 3.0, true);
}

struct Streets {
  SceneBuilder& scene;
  Random houses, cars;
  bool later = false;
  int street = 0;

  void build(int from, int to, bool bare, bool open) {
    const Vector2d a = place_of(from);
    const double whole_m = way_between(from, to);
    const Vector2d along = (place_of(to) - a) / whole_m;
    for (const double side : {1.0, -1.0}) {
      const Front street_front{a, along, side * -right_of(along), whole_m};
      const Front front{a + kCrossingM * along, along, side * -right_of(along),
                        whole_m - 2.0 * kCrossingM};
      if (open && side > 0.0) {
        add_open_side(scene, houses, front);
      } else {
        add_houses(scene, houses, front, bare);
      }
      add_street_furniture(scene, houses, street_front, bare);
      add_parked_cars(scene, cars, front);
      if (later && street == 7 && side > 0.0) add_new_wall(front);
    }
    ++street;
  }

  // The wall stands along the pavement, in front of the houses.
  void add_new_wall(const Front& front) {
    const Vector2d p = front.place(front.length / 2.0, 7.5);
    scene.try_box({p.x(), p.y(), -2.0, 2.5, front.length, 0.3, front.yaw(), 60.0});
  }
};

Scene make_town(const SceneOptions& options, bool later) {
  Random route(options.seed, Stream::kTrajectory, later ? 2 : 1);
  const Path path = lane(round_trip(route));
  const Terrain ground({-100, -100}, {kColumnM * kColumns + 20.0, kRowM * kRows + 40.0}, 1.0,
                       {0.5, 0.03, 0.008}, options.seed);
  SceneBuilder scene;
  Streets streets{scene, Random(options.seed, Stream::kWorld),
                  Random(options.seed, Stream::kWorld, later ? 2 : 1), later};
  scene.keep_clear(path, 2.2);
  for (int crossing = 0; crossing < kColumns * kRows; ++crossing) {
    for (const int next : neighbours(crossing)) {
      if (next < crossing) continue;
      const bool bare = streets.houses.chance(0.12);
      streets.build(crossing, next, bare, streets.houses.chance(0.12));
    }
  }
  return on_ground(scene, ground, path, Drive(), options);
}

}  // namespace

Scene town_scene(const SceneOptions& options) { return make_town(options, false); }
Scene town_later_scene(const SceneOptions& options) { return make_town(options, true); }

}  // namespace zloam::simulator
