#include "common/geometry/deskew.hpp"

namespace zloam {

void bend_motions(const Vector6& bend, std::vector<Pose>& motions) {
  if (bend.isZero(0.0)) return;
  const double steps = static_cast<double>(motions.size()) - 1.0;
  // bent_at() is symmetric about the middle.
  for (std::size_t i = 0; 2 * i < motions.size(); ++i) {
    const std::size_t k = motions.size() - 1 - i;
    const double s = static_cast<double>(i) / steps - 0.5;
    const Pose bent = exp_se3(bent_at(s) * bend);
    motions[i] = motions[i] * bent;
    if (k > i) motions[k] = motions[k] * bent;
  }
}

DeskewTable::DeskewTable(const Vector6& twist_per_s, std::uint32_t period_ns,
                         std::uint32_t instant_ns)
    : step_per_ns_(period_ns == 0 ? 0.0 : static_cast<double>(kSteps) / period_ns),
      motions_(
          exp_se3_along(twist_per_s, -1e-9 * instant_ns, 1e-9 * period_ns / kSteps, kSteps + 1)) {}

DeskewTable DeskewTable::bent(const Vector6& bend) const {
  DeskewTable out = *this;
  bend_motions(bend, out.motions_);
  return out;
}

DeskewTable DeskewTable::in_place_of(const DeskewTable& before) const {
  DeskewTable out = *this;
  for (std::size_t i = 0; i < out.motions_.size(); ++i) {
    out.motions_[i] = motions_[i] * before.motions_[i].inverse();
  }
  return out;
}

std::vector<MotionLanes> DeskewTable::lanes(const Pose& T_moving_points) const {
  std::vector<MotionLanes> out;
  out.reserve(motions_.size());
  for (const Pose& motion : motions_) out.emplace_back(motion * T_moving_points);
  return out;
}

PointVector deskewed(PointSpan points, const DeskewTable& table) {
  PointVector out(points.begin(), points.end());
  for (Point& p : out) {
    const Eigen::Vector3d moved = table.motion_at(p.time_ns) * p.position().cast<double>();
    p.x = static_cast<float>(moved.x());
    p.y = static_cast<float>(moved.y());
    p.z = static_cast<float>(moved.z());
  }
  return out;
}

}  // namespace zloam
