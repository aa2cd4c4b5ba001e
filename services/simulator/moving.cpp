#include "simulator/moving.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <stdexcept>

#include "simulator/scene_builder.hpp"

namespace zloam::simulator {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr double kKeySpacingM = 0.5;

double turn_between(double from_rad, double to_rad) {
  return std::remainder(to_rad - from_rad, 2.0 * std::numbers::pi);
}

// Inserts points so that they are at most kKeySpacingM apart: the track then follows uneven ground.
Polyline dense(const Polyline& points) {
  Polyline out{points.front()};
  for (std::size_t i = 1; i < points.size(); ++i) {
    const Vector2d step = points[i] - points[i - 1];
    const auto parts = std::max(1, static_cast<int>(std::ceil(step.norm() / kKeySpacingM)));
    for (int k = 1; k <= parts; ++k) {
      out.push_back(points[i - 1] + step * (static_cast<double>(k) / parts));
    }
  }
  return out;
}

}  // namespace

Track::Track(std::vector<TrackKey> keys, bool repeats, double start_s)
    : keys_(std::move(keys)), repeats_(repeats), start_s_(start_s) {}

Track::State Track::at(double time_s) const {
  if (keys_.empty()) {
    return {};
  }
  const double begin = keys_.front().time_s;
  const double period = keys_.back().time_s - begin;
  double t = time_s + start_s_;
  if (repeats_ && period > 0.0) {
    t -= std::floor((t - begin) / period) * period;
  }
  const auto next = std::upper_bound(keys_.begin(), keys_.end(), t,
                                     [](double v, const TrackKey& key) { return v < key.time_s; });
  if (next == keys_.begin() || next == keys_.end()) {
    const TrackKey& key = next == keys_.end() ? keys_.back() : keys_.front();
    return {key.place, Vector3d::Zero(), key.yaw_rad};
  }
  const TrackKey& a = *std::prev(next);
  const double span = next->time_s - a.time_s;
  const double u = (t - a.time_s) / span;
  const Vector3d step = next->place - a.place;
  return {a.place + u * step, step / span, a.yaw_rad + u * turn_between(a.yaw_rad, next->yaw_rad)};
}

Track walk(Polyline points, double speed_m_s, double start_m, Repeat repeat,
           const std::function<double(double, double)>& ground) {
  if (points.size() < 2 || !(speed_m_s > 0.0)) {
    throw std::invalid_argument("what moves needs two points and a speed above 0");
  }
  if (repeat == Repeat::kLoop) {
    points.push_back(points.front());
  } else if (repeat == Repeat::kToAndFro) {
    points.insert(points.end(), std::next(points.rbegin()), points.rend());
  }
  points = dense(points);
  std::vector<TrackKey> keys(points.size());
  for (std::size_t i = 0; i < points.size(); ++i) {
    const Vector2d& p = points[i];
    keys[i].place = {p.x(), p.y(), ground ? ground(p.x(), p.y()) : 0.0};
    if (i > 0) {
      const Vector2d step = p - points[i - 1];
      keys[i].time_s = keys[i - 1].time_s + step.norm() / speed_m_s;
      keys[i - 1].yaw_rad = std::atan2(step.y(), step.x());
    }
  }
  keys.back().yaw_rad =
      repeat == Repeat::kOnce ? keys[keys.size() - 2].yaw_rad : keys.front().yaw_rad;
  return {std::move(keys), repeat != Repeat::kOnce, start_m / speed_m_s};
}

Mover car(bool van, double reflectivity, Track track) {
  SceneBuilder builder;
  if (van) {
    builder.box({0.0, 0.0, 0.25, 2.3, 5.0, 1.9, 0.0, reflectivity});
  } else {
    builder.box({0.0, 0.0, 0.2, 0.95, 4.4, 1.75, 0.0, reflectivity});
    builder.box({-0.2, 0.0, 0.95, 1.5, 2.3, 1.5, 0.0, reflectivity});
  }
  return {builder.take(), std::move(track)};
}

Mover person(double height_m, Track track) {
  SceneBuilder builder;
  const double head = 0.12;
  builder.cylinder(0.0, 0.12, 0.08, 0.0, 0.85, 25.0);
  builder.cylinder(0.0, -0.12, 0.08, 0.0, 0.85, 25.0);
  const double low = 0.8;
  const double high = height_m - 2.0 * head;
  builder.ellipsoid({0.0, 0.0, (low + high) / 2.0}, {0.16, 0.24, (high - low) / 2.0}, 40.0);
  builder.ellipsoid({0.0, 0.0, height_m - head}, {head, head, head}, 35.0);
  return {builder.take(), std::move(track)};
}

}  // namespace zloam::simulator
