#include "simulator/path.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <stdexcept>
#include <string>

#include "simulator/random.hpp"

namespace zloam::simulator {
namespace {

using Eigen::Vector2d;
using std::numbers::pi;

constexpr double kKnotStepS = 0.02;
constexpr double kEndStillS = 0.5;
constexpr double kSuspensionS = 0.6;  // time over which bumps of the ground reach the sensor

double radians(double degrees) { return degrees * pi / 180.0; }

std::vector<double> hann(std::size_t half_width) {
  std::vector<double> weights(2 * half_width + 1);
  double sum = 0.0;
  for (std::size_t i = 0; i < weights.size(); ++i) {
    const double phase = static_cast<double>(i + 1) / static_cast<double>(weights.size() + 1);
    weights[i] = 1.0 - std::cos(2.0 * pi * phase);
    sum += weights[i];
  }
  for (double& weight : weights) {
    weight /= sum;
  }
  return weights;
}

// Moving average with a Hann window. Beyond its ends, a closed line continues at its other end, an
// open one keeps the value of its end.
template <typename T>
std::vector<T> smoothed(const std::vector<T>& in, std::size_t half_width, bool closed) {
  const std::vector<double> weights = hann(half_width);
  const auto n = static_cast<std::int64_t>(in.size());
  std::vector<T> out;
  out.reserve(in.size());
  for (std::int64_t i = 0; i < n; ++i) {
    T sum = in[static_cast<std::size_t>(i)] * 0.0;
    for (std::size_t k = 0; k < weights.size(); ++k) {
      std::int64_t j = i + static_cast<std::int64_t>(k) - static_cast<std::int64_t>(half_width);
      j = closed ? ((j % n) + n) % n : std::clamp<std::int64_t>(j, 0, n - 1);
      sum += in[static_cast<std::size_t>(j)] * weights[k];
    }
    out.push_back(sum);
  }
  return out;
}

double turn_between(const Vector2d& in, const Vector2d& out) {
  return std::atan2(in.x() * out.y() - in.y() * out.x(), in.dot(out));
}

// Points of the arc that rounds the corner at b, between a and c.
Polyline rounded_corner(const Vector2d& a, const Vector2d& b, const Vector2d& c, double radius) {
  const Vector2d in = (b - a).normalized();
  const Vector2d out = (c - b).normalized();
  const double turn = turn_between(in, out);
  if (std::abs(turn) < 1e-6) {
    return {b};
  }
  const double cut = radius * std::tan(std::abs(turn) / 2.0);
  const Vector2d start = b - cut * in;
  const Vector2d left(-in.y(), in.x());
  const double side = turn > 0.0 ? 1.0 : -1.0;
  const Vector2d centre = start + side * radius * left;
  Polyline arc;
  const int steps = std::max(2, static_cast<int>(radius * std::abs(turn) / 0.02));
  for (int i = 0; i <= steps; ++i) {
    const double angle = side * std::abs(turn) * i / steps;
    const Vector2d arm = start - centre;
    arc.push_back(centre + Vector2d(std::cos(angle) * arm.x() - std::sin(angle) * arm.y(),
                                    std::sin(angle) * arm.x() + std::cos(angle) * arm.y()));
  }
  return arc;
}

// Throws if the arcs of two corners overlap, because the path would then double back on itself.
void check_room(const Polyline& way, double radius, bool closed) {
  const std::size_t n = way.size();
  double before = 0.0;  // length of the segment that the arc at its start replaces
  for (std::size_t i = 1; i < n + (closed ? 1 : 0); ++i) {
    const Vector2d segment = way[i % n] - way[i - 1];
    const bool corner = i + (closed ? 0 : 1) < n;
    const double turn = corner ? turn_between(segment, way[(i + 1) % n] - way[i]) : 0.0;
    const double after = radius * std::tan(std::abs(turn) / 2.0);
    if (before + after > segment.norm()) {
      throw std::invalid_argument("a corner radius of " + std::to_string(radius) +
                                  " m is too large for the way points");
    }
    before = after;
  }
}

Polyline rounded(const Polyline& way, double radius, bool closed) {
  check_room(way, radius, closed);
  Polyline out{way.front()};
  const std::size_t n = way.size();
  for (std::size_t i = 1; i < n; ++i) {
    if (i + 1 == n && !closed) {
      out.push_back(way[i]);
      break;
    }
    const Polyline arc = rounded_corner(way[i - 1], way[i], way[(i + 1) % n], radius);
    out.insert(out.end(), arc.begin(), arc.end());
  }
  if (closed) {
    out.push_back(way.front());
  }
  return out;
}

// Resamples the polyline at nearly the given spacing, adjusted to divide the length exactly.
Path resampled(const Polyline& line, double spacing) {
  std::vector<double> s{0.0};
  for (std::size_t i = 1; i < line.size(); ++i) {
    s.push_back(s.back() + (line[i] - line[i - 1]).norm());
  }
  const auto steps = static_cast<std::size_t>(std::round(s.back() / spacing));
  Path path{s.back() / static_cast<double>(steps), {}};
  std::size_t segment = 1;
  for (std::size_t i = 0; i <= steps; ++i) {
    const double target = std::min(path.spacing_m * static_cast<double>(i), s.back());
    while (segment + 1 < line.size() && s[segment] < target) {
      ++segment;
    }
    const double span = s[segment] - s[segment - 1];
    const double u = span > 0.0 ? (target - s[segment - 1]) / span : 0.0;
    path.points.push_back(line[segment - 1] + u * (line[segment] - line[segment - 1]));
  }
  return path;
}

// Distance driven at equal time steps, at a speed limited by the curvature and the acceleration.
std::vector<double> distance_over_time(const Path& path, const Drive& options, Random& random,
                                       double step_s) {
  const std::vector<double> heading = path.headings();
  const std::size_t n = path.points.size();
  const double ds = path.spacing_m;
  const double phase_a = random.uniform(0.0, 2.0 * pi);
  const double phase_b = random.uniform(0.0, 2.0 * pi);
  const double wave_m = 6.0 * options.max_speed_m_s;
  std::vector<double> speed(n);
  for (std::size_t i = 0; i < n; ++i) {
    const double s = ds * static_cast<double>(i);
    const double wander = 0.5 * (1.0 + std::sin(2.0 * pi * s / wave_m + phase_a) *
                                           std::sin(2.0 * pi * s / (3.7 * wave_m) + phase_b));
    const std::size_t j = std::min(i + 1, n - 1);
    const double curvature = std::abs(heading[j] - heading[j - 1]) / ds;
    speed[i] = std::min(options.max_speed_m_s * (1.0 - options.speed_variation * wander),
                        std::sqrt(options.max_lateral_m_s2 / std::max(curvature, 1e-9)));
  }
  speed.front() = 0.0;
  speed.back() = 0.0;
  const double gain = 2.0 * options.acceleration_m_s2 * ds;
  for (std::size_t i = 1; i < n; ++i) {
    speed[i] = std::min(speed[i], std::sqrt(speed[i - 1] * speed[i - 1] + gain));
  }
  for (std::size_t i = n - 1; i-- > 0;) {
    speed[i] = std::min(speed[i], std::sqrt(speed[i + 1] * speed[i + 1] + gain));
  }
  std::vector<double> distance(static_cast<std::size_t>(options.still_s / step_s), 0.0);
  double time = 0.0;
  double next = 0.0;
  for (std::size_t i = 1; i < n; ++i) {
    const double lap = 2.0 * ds / (speed[i] + speed[i - 1]);
    while (next <= time + lap) {
      distance.push_back(ds * (static_cast<double>(i - 1) + (next - time) / lap));
      next += step_s;
    }
    time += lap;
  }
  const auto rest = static_cast<std::size_t>(kEndStillS / step_s);
  distance.insert(distance.end(), rest, path.length_m());
  return distance;
}

// Height and tilt of the platform on the ground, smoothed by its suspension.
std::vector<Eigen::Vector3d> ground_following(const std::vector<Vector2d>& places,
                                              const std::vector<double>& yaws,
                                              const Drive& options) {
  constexpr double kWheelbaseM = 1.2;
  std::vector<Eigen::Vector3d> out(places.size(), Eigen::Vector3d::Zero());
  if (!options.ground) {
    return out;
  }
  const auto height = [&](const Vector2d& p) { return options.ground(p.x(), p.y()); };
  for (std::size_t i = 0; i < places.size(); ++i) {
    const Vector2d ahead(std::cos(yaws[i]), std::sin(yaws[i]));
    const Vector2d left(-ahead.y(), ahead.x());
    const Vector2d& p = places[i];
    const double rise = height(p + kWheelbaseM * ahead) - height(p - kWheelbaseM * ahead);
    const double bank = height(p + kWheelbaseM * left) - height(p - kWheelbaseM * left);
    out[i] = {height(p), -std::atan(rise / (2.0 * kWheelbaseM)),
              std::atan(bank / (2.0 * kWheelbaseM))};
  }
  return smoothed(out, static_cast<std::size_t>(kSuspensionS / kKnotStepS / 2.0), false);
}

// 0 while standing, 1 while driving, with two smooth derivatives.
double engaged(double time_s, double still_s, double end_s) {
  const auto step = [](double u) {
    const double c = std::clamp(u, 0.0, 1.0);
    return c * c * c * (10.0 + c * (6.0 * c - 15.0));
  };
  return step((time_s - still_s) / 1.5) * step((end_s - time_s) / 1.5);
}

}  // namespace

Vector2d Path::at(double s_m) const {
  const double position =
      std::clamp(s_m / spacing_m, 0.0, static_cast<double>(points.size() - 1) - 1e-9);
  const auto i = static_cast<std::size_t>(position);
  const double u = position - static_cast<double>(i);
  return (1.0 - u) * points[i] + u * points[i + 1];
}

std::vector<double> Path::headings() const {
  std::vector<double> out(points.size());
  for (std::size_t i = 0; i < points.size(); ++i) {
    const Vector2d step = points[std::min(i + 1, points.size() - 1)] - points[i > 0 ? i - 1 : 0];
    const double heading = std::atan2(step.y(), step.x());
    out[i] = i == 0 ? heading : out[i - 1] + std::remainder(heading - out[i - 1], 2.0 * pi);
  }
  return out;
}

Path Path::repeated(int laps) const {
  Path out = *this;
  if (laps == 1) {
    return out;
  }
  if (laps < 1 || (points.back() - points.front()).norm() > spacing_m) {
    throw std::invalid_argument(std::to_string(laps) +
                                " laps: only a path that ends where it began has several");
  }
  for (int lap = 1; lap < laps; ++lap) {
    out.points.insert(out.points.end(), points.begin() + 1, points.end());
  }
  return out;
}

Path smooth_path(const Polyline& way_points, double corner_radius_m, double smoothing_m,
                 bool closed) {
  constexpr double kSpacingM = 0.01;
  Path path = resampled(rounded(way_points, corner_radius_m, closed), kSpacingM);
  const auto half_width = static_cast<std::size_t>(smoothing_m / kSpacingM / 2.0);
  if (closed) {
    path.points.pop_back();  // equals the first one
    path.points = smoothed(path.points, half_width, true);
    path.points.push_back(path.points.front());
  } else {
    path.points = smoothed(path.points, half_width, false);
  }
  return resampled(path.points, kSpacingM);
}

Trajectory drive(const Path& once, const Drive& options, std::uint64_t seed) {
  const Path path = once.repeated(options.laps);
  Random random(seed, Stream::kTrajectory);
  const std::vector<double> s =
      smoothed(distance_over_time(path, options, random, kKnotStepS), 12, false);
  const std::vector<double> headings = path.headings();
  std::vector<Vector2d> places;
  std::vector<double> yaws;
  for (const double distance : s) {
    const double position =
        std::clamp(distance / path.spacing_m, 0.0, static_cast<double>(headings.size()) - 1.001);
    const auto i = static_cast<std::size_t>(position);
    const double u = position - static_cast<double>(i);
    places.push_back(path.at(distance));
    yaws.push_back((1.0 - u) * headings[i] + u * headings[i + 1] + radians(options.heading_deg));
  }
  const std::vector<Eigen::Vector3d> ground = ground_following(places, yaws, options);
  double phase[6];
  for (double& p : phase) {
    p = random.uniform(0.0, 2.0 * pi);
  }
  const double end_s = kKnotStepS * static_cast<double>(s.size() - 1) - kEndStillS;
  std::vector<Knot> knots;
  for (std::size_t i = 0; i < s.size(); ++i) {
    const double t = kKnotStepS * static_cast<double>(i);
    const double gain = engaged(t, options.still_s, end_s);
    const auto wave = [&](double ratio, double start) {
      return gain * (0.8 * std::sin(2.0 * pi * options.sway_hz * ratio * t + start) +
                     0.2 * std::sin(2.0 * pi * options.sway_hz * 1.7 * ratio * t + 2.0 * start));
    };
    const double swing_growth = std::clamp((t - options.still_s) / (0.4 * end_s), 0.0, 1.0);
    const double swing = gain * (0.3 + 0.7 * swing_growth) * radians(options.yaw_swing_deg) *
                         std::sin(2.0 * pi * options.yaw_swing_hz * t + phase[5]);
    Knot knot;
    knot << places[i].x(), places[i].y(),
        options.height_m + ground[i].x() + options.bob_m * wave(1.9, phase[0]), yaws[i] + swing,
        ground[i].y() + radians(options.pitch_deg) * wave(1.37, phase[1]),
        ground[i].z() + radians(options.roll_deg) * wave(1.0, phase[2]);
    knots.push_back(knot);
  }
  return {std::move(knots), kKnotStepS};
}

}  // namespace zloam::simulator
