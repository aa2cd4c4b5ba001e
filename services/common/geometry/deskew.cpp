#include "common/geometry/deskew.hpp"

#include <algorithm>

namespace zloam {

DeskewTable::DeskewTable(const Vector6& twist_per_s, std::uint32_t period_ns,
                         std::uint32_t instant_ns)
    : step_per_ns_(period_ns == 0 ? 0.0 : static_cast<double>(kSteps) / period_ns),
      motions_(
          exp_se3_along(twist_per_s, -1e-9 * instant_ns, 1e-9 * period_ns / kSteps, kSteps + 1)) {}

DeskewTable DeskewTable::in_place_of(const DeskewTable& before) const {
  DeskewTable out = *this;
  for (std::size_t i = 0; i < out.motions_.size(); ++i) {
    out.motions_[i] = motions_[i] * before.motions_[i].inverse();
  }
  return out;
}

const Pose& DeskewTable::motion_at(std::uint32_t time_ns) const {
  // Cut off after adding a half: the nearest step, without a call for each point.
  const double above = time_ns * step_per_ns_ + 0.5;
  return motions_[std::min<std::size_t>(static_cast<std::size_t>(above), kSteps)];
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
