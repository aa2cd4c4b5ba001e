// World moving: the city's streets with traffic. A van ahead and one behind keep their distance to
// the platform, cars come the other way, people walk on the pavements and across the street.

#include <algorithm>
#include <cmath>

#include "simulator/random.hpp"
#include "simulator/scenes.hpp"

namespace zloam::simulator {
namespace {

using Eigen::Vector2d;

constexpr double kLaneM = 2.4;  // from the platform's path to the middle of the other lane
constexpr double kNearestPersonM = 1.5;
constexpr double kAheadM = 12.0;
constexpr double kBehindM = -11.0;

// The platform's path, and the distance along it at equal time steps.
struct Way {
  static constexpr double kStepS = 0.05;
  Polyline points;  // closed, without repetition of the first one
  std::vector<double> along;

  double length() const { return along.back(); }
};

Way way_of(const Trajectory& trajectory) {
  Way way;
  double driven = 0.0;
  double placed = -1.0;
  Vector2d last = trajectory.at(0.0).T_world_body.translation().head<2>();
  for (int i = 0; Way::kStepS * i <= trajectory.duration_s(); ++i) {
    const Vector2d p = trajectory.at(Way::kStepS * i).T_world_body.translation().head<2>();
    driven += (p - last).norm();
    last = p;
    way.along.push_back(driven);
    if (driven >= placed + 1.0) {
      way.points.push_back(p);
      placed = driven;
    }
  }
  return way;
}

// Place and direction of travel at a distance along the closed way.
struct Place {
  Vector2d p;
  Vector2d ahead;
  Vector2d left() const { return {-ahead.y(), ahead.x()}; }
};

Place place_at(const Way& way, double s) {
  const double wrapped = s - std::floor(s / way.length()) * way.length();
  const std::size_t n = way.points.size();
  const double position = wrapped / way.length() * static_cast<double>(n);
  const auto i = static_cast<std::size_t>(position) % n;
  const Vector2d step = way.points[(i + 1) % n] - way.points[i];
  const double u = position - std::floor(position);
  return {way.points[i] + u * step, step.normalized()};
}

// The track of an object at a constant distance along the way from the platform.
Track escort(const Way& way, double ahead_m, const Terrain& ground) {
  std::vector<TrackKey> keys;
  for (std::size_t i = 0; i < way.along.size(); ++i) {
    const Place place = place_at(way, way.along[i] + ahead_m);
    keys.push_back({Way::kStepS * static_cast<double>(i),
                    {place.p.x(), place.p.y(), ground.height(place.p.x(), place.p.y())},
                    std::atan2(place.ahead.y(), place.ahead.x())});
  }
  return {std::move(keys), false};
}

bool keeps_away(const Track& track, const Trajectory& platform, double distance_m) {
  constexpr double kStepS = 0.05;
  for (int i = 0; kStepS * i <= platform.duration_s(); ++i) {
    const double t = kStepS * i;
    const Vector2d gap = (track.at(t).place - platform.at(t).T_world_body.translation()).head<2>();
    if (gap.norm() < distance_m) {
      return false;
    }
  }
  return true;
}

void add_cars(std::vector<Mover>& movers, Random& random, const Way& way, const Terrain& ground) {
  const auto height = [&](double x, double y) { return ground.height(x, y); };
  movers.push_back(car(true, 60.0, escort(way, kAheadM, ground)));
  movers.push_back(car(true, 45.0, escort(way, kBehindM, ground)));
  Polyline lane;  // lane of the oncoming cars: in the opposite direction, on the other side
  for (int i = 0; i < way.length(); ++i) {
    const Place place = place_at(way, way.length() - i);
    lane.push_back(place.p + kLaneM * place.left());
  }
  const double speed = 8.0;  // the same for all cars, so that they do not collide
  constexpr int kCars = 16;
  for (int i = 0; i < kCars; ++i) {
    const double start = way.length() * (i + random.uniform(0.0, 0.6)) / kCars;
    movers.push_back(car(random.chance(0.3), random.uniform(8.0, 80.0),
                         walk(lane, speed, start, Repeat::kLoop, height)));
  }
}

void add_people(std::vector<Mover>& movers, Random& random, const Way& way,
                const Trajectory& platform, const Terrain& ground) {
  const auto height = [&](double x, double y) { return ground.height(x, y); };
  constexpr int kPeople = 70;
  for (int i = 0; i < kPeople; ++i) {
    const Place place = place_at(way, way.length() * (i + random.uniform(0.0, 0.5)) / kPeople);
    const double side = random.sign();
    Polyline points;
    if (random.chance(0.4)) {  // across the street
      points = {place.p + 7.0 * side * place.left(), place.p - 7.0 * side * place.left()};
    } else {  // along the pavement
      const Vector2d middle = place.p + side * random.uniform(5.6, 7.6) * place.left();
      const double reach = random.uniform(4.0, 12.0);
      points = {middle - reach * place.ahead, middle + reach * place.ahead};
    }
    const double speed = random.uniform(0.8, 1.8);
    const double tall = random.uniform(1.5, 1.95);
    for (int attempt = 0; attempt < 10; ++attempt) {  // until the platform is not in the way
      Track track = walk(points, speed, random.uniform(0.0, 30.0), Repeat::kToAndFro, height);
      if (keeps_away(track, platform, kNearestPersonM)) {
        movers.push_back(person(tall, std::move(track)));
        break;
      }
    }
  }
}

}  // namespace

Scene moving_scene(const SceneOptions& options) {
  const Scene city = city_scene(options);
  const Terrain& ground = *city.world.terrain();
  const Way way = way_of(city.trajectory);
  Random random(options.seed, Stream::kMovers);
  std::vector<Mover> movers;
  add_cars(movers, random, way, ground);
  add_people(movers, random, way, city.trajectory, ground);
  return {World(city.world.shapes(), ground, std::move(movers)), city.trajectory};
}

}  // namespace zloam::simulator
