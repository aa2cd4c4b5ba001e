#include "registration/ring_sort.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "common/containers/thinning.hpp"

namespace zloam::registration {
namespace {

// If two points are more than this many typical steps apart, a firing between them gave no return.
constexpr double kAdjacentSteps = 1.6;
// Width of a beam.
constexpr double kBeam_rad = 0.0035;
constexpr double kRightAngle_rad = 0.5 * std::numbers::pi;

bool wanted_return(ReturnType type, ReturnSelection selection) {
  switch (selection) {
    case ReturnSelection::kStrongest:
      return type == ReturnType::kStrongest || type == ReturnType::kBoth;
    case ReturnSelection::kLast:
      return type == ReturnType::kLast || type == ReturnType::kBoth;
    case ReturnSelection::kAll:
      return true;
  }
  return true;
}

void reject(const Point& point, RejectReason reason, RegistrationResult& result) {
  result.rejected.push_back(point);
  result.reasons.push_back(reason);
  ++result.diagnostics.rejected[static_cast<std::size_t>(reason)];
}

// Range of a usable point; negative if it was rejected.
float usable_range(const Point& point, const SweepInfo& info, const RegistrationConfig& config,
                   RegistrationResult& result) {
  const float range = point.position().norm();
  if (!std::isfinite(range)) {
    reject(point, RejectReason::kNotFinite, result);
  } else if (!info.one_return && !wanted_return(point.return_type, config.returns)) {
    reject(point, RejectReason::kOtherReturn, result);
  } else if (range < config.min_range_m) {
    reject(point, RejectReason::kTooNear, result);
  } else if (range > config.max_range_m) {
    reject(point, RejectReason::kTooFar, result);
  } else {
    return range;
  }
  return -1.0F;
}

// Replaces the ring in clouds without rings. If the lidar rotates, points of one elevation, within
// a beam's width, are on one line; in a pattern that crosses itself, few points share an elevation.
std::uint16_t elevation_step(const Point& point) {
  const double elevation_rad = std::atan2(point.z, std::hypot(point.x, point.y));
  return static_cast<std::uint16_t>(std::lround((elevation_rad + kRightAngle_rad) / kBeam_rad));
}

double angle_between(const Point& a, const Point& b) {
  const Eigen::Vector3d p = a.position().cast<double>();
  const Eigen::Vector3d q = b.position().cast<double>();
  return std::atan2(p.cross(q).norm(), p.dot(q));
}

// Orders pairs by their angle without computing it; infinite from a right angle on.
double tangent_between(const Point& a, const Point& b) {
  const Eigen::Vector3d p = a.position().cast<double>();
  const Eigen::Vector3d q = b.position().cast<double>();
  const double along = p.dot(q);
  return along > 0.0 ? p.cross(q).norm() / along : std::numeric_limits<double>::infinity();
}

template <typename T>
T median(std::vector<T>& values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

// Typical angle and time between firings, from a sample of neighbouring points.
void measure_steps(RingSorted& sorted) {
  // A sample of this size gives the median precisely enough.
  constexpr std::size_t kEnough = 5000;
  constexpr std::size_t kStride = 5;
  const auto stride =
      static_cast<std::uint32_t>(std::max(kStride, stride_to(kEnough, sorted.points.size())));
  std::vector<std::uint32_t> intervals;
  std::vector<double> tangents;  // monotonic in the angle, so medians match
  for (std::size_t ring = 0; ring + 1 < sorted.ring_begin.size(); ++ring) {
    for (std::uint32_t i = sorted.ring_begin[ring]; i + 1 < sorted.ring_begin[ring + 1];
         i += stride) {
      const std::uint32_t dt = sorted.points[i + 1].time_ns - sorted.points[i].time_ns;
      if (dt > 0) {
        intervals.push_back(dt);
      }
      tangents.push_back(tangent_between(sorted.points[i], sorted.points[i + 1]));
    }
  }
  // Two returns of one firing have no angle between them, and would bias the median.
  std::erase_if(tangents, [](double t) { return t < 1e-6; });
  if (!tangents.empty()) sorted.step_rad = std::atan(median(tangents));
  if (intervals.size() * 2 > tangents.size() && !intervals.empty()) {
    sorted.firing_interval_ns = median(intervals);
  }
}

}  // namespace

RingSorted sort_by_ring(PointSpan sweep, const SweepInfo& info, const RegistrationConfig& config,
                        RegistrationResult& result) {
  RingSorted sorted;
  std::vector<float> ranges(sweep.size());
  std::vector<std::uint16_t> rings(sweep.size());
  std::vector<std::uint32_t> next(info.rings + 1U, 0);
  for (std::size_t i = 0; i < sweep.size(); ++i) {
    ranges[i] = usable_range(sweep[i], info, config, result);
    if (ranges[i] >= 0.0F) {
      rings[i] = info.rings == 0 ? elevation_step(sweep[i]) : sweep[i].ring;
      if (rings[i] + 2U > next.size()) {
        next.resize(rings[i] + 2U, 0);
      }
      ++next[rings[i] + 1U];
    }
  }
  for (std::size_t r = 1; r < next.size(); ++r) {
    next[r] += next[r - 1];
  }
  sorted.ring_begin = next;
  sorted.points.resize(next.back());
  sorted.range_m.resize(next.back());
  for (std::size_t i = 0; i < sweep.size(); ++i) {
    if (ranges[i] >= 0.0F) {
      const std::uint32_t slot = next[rings[i]]++;
      sorted.points[slot] = sweep[i];
      sorted.points[slot].ring = rings[i];
      sorted.range_m[slot] = ranges[i];
    }
  }
  if (info.rings > 0) measure_steps(sorted);
  return sorted;
}

bool adjacent(const RingSorted& sorted, std::uint32_t i) {
  const Point& a = sorted.points[i];
  const Point& b = sorted.points[i + 1];
  if (sorted.firing_interval_ns > 0) {
    // A step back in time wraps to a large number, so the points do not count as adjacent.
    return b.time_ns - a.time_ns <= kAdjacentSteps * sorted.firing_interval_ns;
  }
  return sorted.step_rad > 0.0 && angle_between(a, b) <= kAdjacentSteps * sorted.step_rad;
}

double steps_after(const RingSorted& sorted, std::uint32_t i) {
  const Point& a = sorted.points[i];
  const Point& b = sorted.points[i + 1];
  if (sorted.firing_interval_ns > 0 && b.time_ns >= a.time_ns) {
    return static_cast<double>(b.time_ns - a.time_ns) / sorted.firing_interval_ns;
  }
  if (sorted.firing_interval_ns > 0 || sorted.step_rad <= 0.0) {
    return std::numeric_limits<double>::infinity();
  }
  return angle_between(a, b) / sorted.step_rad;
}

}  // namespace zloam::registration
