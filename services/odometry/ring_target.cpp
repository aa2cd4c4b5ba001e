#include "odometry/ring_target.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

namespace zloam::odometry {
namespace {

// Means of successive points of one ring that lie within leaf_m of the first of them.
PointVector thinned(PointSpan points, double leaf_m) {
  if (leaf_m <= 0.0) {
    return PointVector(points.begin(), points.end());
  }
  PointVector out;
  const auto leaf2 = static_cast<float>(leaf_m * leaf_m);
  for (std::size_t i = 0; i < points.size();) {
    Eigen::Vector3f sum = Eigen::Vector3f::Zero();
    std::size_t j = i;
    while (j < points.size() && points[j].ring == points[i].ring &&
           !((points[j].position() - points[i].position()).squaredNorm() > leaf2)) {
      sum += points[j].position();
      ++j;
    }
    const Eigen::Vector3f mean = sum / static_cast<float>(j - i);
    Point p = points[i];
    p.x = mean.x();
    p.y = mean.y();
    p.z = mean.z();
    out.push_back(p);
    i = j;
  }
  return out;
}

}  // namespace

int RingIndex::bin_of(const Eigen::Vector3f& p) const {
  const double turn = std::atan2(p.y(), p.x()) / (2.0 * std::numbers::pi) + 0.5;
  return std::clamp(static_cast<int>(turn * kBins), 0, kBins - 1);
}

void RingIndex::build(PointSpan points, double leaf_m) {
  const PointVector kept = thinned(points, leaf_m);
  rings_ = 0;
  for (const Point& p : kept) {
    rings_ = std::max(rings_, p.ring + 1);
  }
  std::vector<std::uint32_t> slot(kept.size());
  bin_begin_.assign(static_cast<std::size_t>(rings_) * kBins + 1, 0);
  for (std::size_t i = 0; i < kept.size(); ++i) {
    slot[i] = static_cast<std::uint32_t>(kept[i].ring * kBins + bin_of(kept[i].position()));
    ++bin_begin_[slot[i] + 1];
  }
  for (std::size_t b = 1; b < bin_begin_.size(); ++b) {
    bin_begin_[b] += bin_begin_[b - 1];
  }
  positions_.resize(kept.size());
  std::vector<std::uint32_t> next(bin_begin_.begin(), bin_begin_.end() - 1);
  for (std::size_t i = 0; i < kept.size(); ++i) {
    positions_[next[slot[i]]++] = kept[i].position();
  }
}

int RingIndex::nearest(const Eigen::Vector3f& query, int ring, float radius_m, int except) const {
  if (ring < 0 || ring >= rings_) {
    return -1;
  }
  float best2 = radius_m * radius_m;
  int best = -1;
  const auto look = [&](int bin) {
    const std::size_t slot = static_cast<std::size_t>(ring) * kBins + static_cast<std::size_t>(bin);
    for (std::uint32_t i = bin_begin_[slot]; i < bin_begin_[slot + 1]; ++i) {
      const float d2 = (positions_[i] - query).squaredNorm();
      if (d2 < best2 && static_cast<int>(i) != except) {
        best2 = d2;
        best = static_cast<int>(i);
      }
    }
  };
  const int centre = bin_of(query);
  const float axis_distance = std::hypot(query.x(), query.y());
  look(centre);
  for (int k = 1; k <= kBins / 2; ++k) {
    // Everything in bin centre +- k is at least k - 1 bins away: by axis_distance * sin below a
    // right angle, by axis_distance from there on.
    const double angle = std::min((k - 1) * 2.0 * std::numbers::pi / kBins, std::numbers::pi / 2);
    const auto bound = static_cast<float>(axis_distance * std::sin(angle));
    if (bound * bound >= best2) {
      break;
    }
    look((centre + k) % kBins);
    if (2 * k != kBins) {
      look((centre - k + kBins) % kBins);
    }
  }
  return best;
}

void RingTarget::set(PointSpan edges, PointSpan planes, const Pose& T_odom_base,
                     const Pose& T_base_lidar) {
  T_odom_lidar_ = T_odom_base * T_base_lidar;
  T_lidar_odom_ = T_odom_lidar_.inverse();
  const Eigen::Isometry3f T_lidar_base = T_base_lidar.inverse().cast<float>();
  const auto in_lidar = [&](PointSpan points) {
    PointVector out(points.begin(), points.end());
    for (Point& p : out) {
      const Eigen::Vector3f q = T_lidar_base * p.position();
      p.x = q.x();
      p.y = q.y();
      p.z = q.z();
    }
    return out;
  };
  edges_.build(in_lidar(edges), 0.0);
  planes_.build(in_lidar(planes), config_.target_leaf_m);
}

void RingTarget::clear() {
  edges_ = {};
  planes_ = {};
}

RingTarget::Match RingTarget::nearest_of_all(const RingIndex& index,
                                             const Eigen::Vector3f& query) const {
  Match best;
  auto radius = static_cast<float>(config_.match_radius_m);
  for (int ring = 0; ring < index.rings(); ++ring) {
    const int i = index.nearest(query, ring, radius);
    if (i >= 0) {
      best = {i, ring};
      radius = (index.position(i) - query).norm();
    }
  }
  return best;
}

int RingTarget::nearest_of_others(const RingIndex& index, const Eigen::Vector3f& query,
                                  int ring) const {
  int best = -1;
  auto radius = static_cast<float>(config_.match_radius_m);
  for (int other = ring - config_.ring_reach; other <= ring + config_.ring_reach; ++other) {
    const int i = other == ring ? -1 : index.nearest(query, other, radius);
    if (i >= 0) {
      best = i;
      radius = (index.position(i) - query).norm();
    }
  }
  return best;
}

std::optional<TargetLine> RingTarget::line(const Eigen::Vector3d& point_odom) const {
  const Eigen::Vector3f query = (T_lidar_odom_ * point_odom).cast<float>();
  const Match first = nearest_of_all(edges_, query);
  if (first.index < 0) {
    return std::nullopt;
  }
  const int second = nearest_of_others(edges_, query, first.ring);
  if (second < 0) {
    return std::nullopt;
  }
  const Eigen::Vector3d a = edges_.position(first.index).cast<double>();
  const Eigen::Vector3d b = edges_.position(second).cast<double>();
  const double length = (b - a).norm();
  if (length < 1e-3) {
    return std::nullopt;
  }
  return TargetLine{T_odom_lidar_ * a, T_odom_lidar_.linear() * (b - a) / length};
}

std::optional<TargetPlane> RingTarget::plane(const Eigen::Vector3d& point_odom) const {
  // Sine of the smallest angle of the triangle at its first point.
  constexpr double kMinSine = 0.1;
  const Eigen::Vector3f query = (T_lidar_odom_ * point_odom).cast<float>();
  const Match first = nearest_of_all(planes_, query);
  if (first.index < 0) {
    return std::nullopt;
  }
  const auto radius = static_cast<float>(config_.match_radius_m);
  const int second = planes_.nearest(query, first.ring, radius, first.index);
  const int third = nearest_of_others(planes_, query, first.ring);
  if (second < 0 || third < 0) {
    return std::nullopt;
  }
  const Eigen::Vector3d a = planes_.position(first.index).cast<double>();
  const Eigen::Vector3d u = planes_.position(second).cast<double>() - a;
  const Eigen::Vector3d v = planes_.position(third).cast<double>() - a;
  const Eigen::Vector3d n = u.cross(v);
  if (!(n.norm() > kMinSine * u.norm() * v.norm())) {
    return std::nullopt;
  }
  const Eigen::Vector3d normal = T_odom_lidar_.linear() * n.normalized();
  return TargetPlane{normal, normal.dot(T_odom_lidar_ * a)};
}

}  // namespace zloam::odometry
