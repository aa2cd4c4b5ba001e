#include "aloam/core/ring_target.hpp"

#include "aloam/core/clouds.hpp"

namespace zloam::aloam {

RingTarget::RingTarget(PointSpan points) : points_(new pcl::PointCloud<pcl::PointXYZ>) {
  points_->reserve(points.size());
  rings_.reserve(points.size());
  for (const Point& p : points) {
    points_->push_back({p.x, p.y, p.z});
    rings_.push_back(p.ring);
  }
  if (!points_->empty()) tree_.setInputCloud(points_);
}

Eigen::Vector3d RingTarget::at(std::size_t index) const { return position_of((*points_)[index]); }

double RingTarget::squared_m2(const Eigen::Vector3d& point, std::size_t index) const {
  return (at(index) - point).squaredNorm();
}

std::optional<std::size_t> RingTarget::nearest(const Eigen::Vector3d& point) const {
  if (points_->empty()) return std::nullopt;
  pcl::Indices index(1);
  std::vector<float> squared(1);
  const pcl::PointXYZ wanted(static_cast<float>(point.x()), static_cast<float>(point.y()),
                             static_cast<float>(point.z()));
  if (tree_.nearestKSearch(wanted, 1, index, squared) < 1) return std::nullopt;
  if (static_cast<double>(squared[0]) >= kReach_m * kReach_m) return std::nullopt;
  return static_cast<std::size_t>(index[0]);
}

template <class Visit>
void RingTarget::after(std::size_t from, const Visit& visit) const {
  for (std::size_t i = from + 1; i < rings_.size() && rings_[i] <= rings_[from] + kRings; ++i) {
    visit(i);
  }
}

template <class Visit>
void RingTarget::before(std::size_t from, const Visit& visit) const {
  for (std::size_t i = from; i-- > 0 && rings_[i] >= rings_[from] - kRings;) visit(i);
}

std::optional<std::array<Eigen::Vector3d, 2>> RingTarget::line_near(
    const Eigen::Vector3d& point) const {
  const std::optional<std::size_t> first = nearest(point);
  if (!first) return std::nullopt;
  Nearest second;
  // Coordinates that were rounded are equal in two rings: no line has two equal points.
  const auto visit = [&](std::size_t i) {
    if (rings_[i] == rings_[*first] || at(i) == at(*first)) return;
    second.look_at(squared_m2(point, i), i);
  };
  after(*first, visit);
  before(*first, visit);
  if (!second.index()) return std::nullopt;
  return std::array{at(*first), at(*second.index())};
}

std::optional<std::array<Eigen::Vector3d, 3>> RingTarget::plane_near(
    const Eigen::Vector3d& point) const {
  const std::optional<std::size_t> first = nearest(point);
  if (!first) return std::nullopt;
  Nearest beside, beyond;
  const auto visit = [&](std::size_t i) {
    (rings_[i] == rings_[*first] ? beside : beyond).look_at(squared_m2(point, i), i);
  };
  after(*first, visit);
  before(*first, visit);
  if (!beside.index() || !beyond.index()) return std::nullopt;
  return std::array{at(*first), at(*beside.index()), at(*beyond.index())};
}

}  // namespace zloam::aloam
