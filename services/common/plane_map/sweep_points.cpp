#include "common/plane_map/sweep_points.hpp"

#include <algorithm>
#include <cmath>

#include "common/geometry/deskew.hpp"

namespace zloam::plane_map {
namespace {

// Exponentials are computed at knots only, and the matrices interpolated in between: at 190 deg/s
// and 64 knots the chord differs from the arc by 3e-6.
constexpr int kKnots = 64;
constexpr int kSlotsPerKnot = kSlots / kKnots;
static_assert(kSlots == DeskewTable::kSteps, "slots and steps of the deskewing are the same");

bool usable(const Point& p, float min_range2) {
  const float range2 = p.x * p.x + p.y * p.y + p.z * p.z;
  return range2 >= min_range2 && range2 < 1e12f;  // false for NaN
}

// Poses of base_link at the knots, relative to its pose at mid-sweep.
std::vector<Pose> at_knots(const Vector6& twist, const Vector6& bend) {
  if (bend.isZero(0.0)) return exp_se3_along(twist, slot_fraction(0), 1.0 / kKnots, kKnots + 1);
  std::vector<Pose> knots;
  knots.reserve(kKnots + 1);
  for (int k = 0; k <= kKnots; ++k) {
    const double s = slot_fraction(k * kSlotsPerKnot);
    knots.push_back(exp_se3(s * twist + 0.5 * s * s * bend));
  }
  return knots;
}

}  // namespace

void take_points(const SweepInput& sweep, double min_range_m, const Thinning& thinning,
                 std::vector<SlotPoint>& out) {
  const double slots_per_ns =
      sweep.period_ns == 0 ? 0.0 : static_cast<double>(kSlots) / sweep.period_ns;
  const auto min_range2 = static_cast<float>(std::max(min_range_m * min_range_m, 1e-12));
  const std::size_t first_part = sweep.points.size();
  const auto each_usable = [&](const auto& take) {
    const auto take_usable = [&](PointSpan part) {
      for (const Point& p : part) {
        if (!usable(p, min_range2)) continue;
        take(p,
             static_cast<std::uint16_t>(std::min<double>(p.time_ns * slots_per_ns + 0.5, kSlots)));
      }
    };
    thinning.each_stretch(sweep.size(), [&](std::size_t begin, std::size_t end) {
      const std::size_t cut = std::clamp(first_part, begin, end);
      take_usable(sweep.points.subspan(std::min(begin, first_part), cut - begin));
      take_usable(sweep.more_points.subspan(cut - std::min(cut, first_part), end - cut));
    });
  };
  // Stable counting sort. The points are read twice, which is cheaper than storing them in between.
  std::vector<std::uint32_t> next(kSlots + 2, 0);
  each_usable([&](const Point&, std::uint16_t slot) { ++next[slot + 1U]; });
  for (std::size_t i = 1; i < next.size(); ++i) next[i] += next[i - 1];
  out.resize(next.back());
  each_usable([&](const Point& p, std::uint16_t slot) {
    out[next[slot]++] = {p.x, p.y, p.z, slot, p.ring};
  });
}

void SweepPoints::set(const SweepInput& sweep, double min_range_m, const Thinning& thinning) {
  take_points(sweep, min_range_m, thinning, points_);
  T_base_points_ = sweep.T_base_points;
  undo_.clear();
  if (sweep.deskewed) {
    const DeskewTable table(sweep.deskewed->twist_per_s, sweep.period_ns,
                            sweep.deskewed->instant_ns);
    undo_.reserve(kSlots + 1);
    for (int i = 0; i <= kSlots; ++i) {
      const double time_ns = static_cast<double>(sweep.period_ns) * i / kSlots;
      undo_.push_back(table.motion_at(static_cast<std::uint32_t>(time_ns)).inverse() *
                      T_base_points_);
    }
  }
}

SlotMotions SweepPoints::motions(const Eigen::Matrix3d& rotation, const Vector6& twist,
                                 const Vector6& bend) const {
  Pose start = Pose::Identity();
  start.linear() = rotation;
  std::vector<Pose> knots = at_knots(twist, bend);
  for (Pose& knot : knots) knot = start * knot;
  SlotMotions out;
  out.reserve(kSlots + 1);
  for (int i = 0; i <= kSlots; ++i) {
    const int knot = std::min(i / kSlotsPerKnot, kKnots - 1);
    const double part = static_cast<double>(i - knot * kSlotsPerKnot) / kSlotsPerKnot;
    const auto k = static_cast<std::size_t>(knot);
    Pose between;
    between.matrix() = knots[k].matrix() + part * (knots[k + 1].matrix() - knots[k].matrix());
    out.emplace_back(between *
                     (undo_.empty() ? T_base_points_ : undo_[static_cast<std::size_t>(i)]));
  }
  return out;
}

}  // namespace zloam::plane_map
