#include "driver/decoder/motor.hpp"

#include <algorithm>
#include <cmath>

namespace zloam::driver {
namespace {

constexpr double kMinRpm = 180.0;
constexpr double kMaxRpm = 1500.0;

int gap_between(const Group& before, const Group& after) {
  const int gap_cdeg = after.azimuth_cdeg - before.azimuth_cdeg;
  return gap_cdeg < 0 ? gap_cdeg + kTurnCdeg : gap_cdeg;
}

double advance_at(double rpm, double group_ns) { return rpm / 60.0 * kTurnCdeg * group_ns * 1e-9; }

}  // namespace

Motor::Motor(double group_ns)
    : group_ns_(group_ns),
      least_cdeg_(advance_at(kMinRpm, group_ns)),
      greatest_cdeg_(advance_at(kMaxRpm, group_ns)) {}

// The advance is the packet's mean of plausible gaps: the motor's inertia keeps the speed steady,
// and the mean averages out the 0.01 degree rounding of a single gap. Only gaps within the packet
// count, so that a lost packet has no influence.
void Motor::measure(PacketPlan& plan) {
  if (plan.groups == 1) {
    measure_by_packets(plan);
    return;
  }
  if (!measure_even(plan)) measure_uneven(plan);
}

/// Fast path for nearly all packets: if the gaps are this even, all are plausible.
bool Motor::measure_even(PacketPlan& plan) {
  int sum = 0;
  int least = kTurnCdeg;
  int greatest = 0;
  for (int g = 1; g < plan.groups; ++g) {
    if (!plan.group[g - 1].valid || !plan.group[g].valid) return false;
    const int gap_cdeg = gap_between(plan.group[g - 1], plan.group[g]);
    sum += gap_cdeg;
    least = std::min(least, gap_cdeg);
    greatest = std::max(greatest, gap_cdeg);
  }
  if (!plausible(least) || !plausible(greatest) || greatest > 2 * least) return false;
  keep(static_cast<double>(sum) / (plan.groups - 1), plan);
  return true;
}

Motor::Gaps Motor::gaps_of(const PacketPlan& plan) {
  Gaps gaps;
  for (int g = 1; g < plan.groups; ++g) {
    if (!plan.group[g - 1].valid || !plan.group[g].valid) continue;
    gaps.group_after[gaps.count] = g;
    gaps.cdeg[gaps.count++] = gap_between(plan.group[g - 1], plan.group[g]);
  }
  return gaps;
}

void Motor::measure_uneven(PacketPlan& plan) {
  const Gaps gaps = gaps_of(plan);
  std::array<int, kMostGroups> sorted = gaps.cdeg;
  const auto middle = sorted.begin() + gaps.count / 2;
  std::nth_element(sorted.begin(), middle, sorted.begin() + gaps.count);
  const int median = gaps.count > 0 ? *middle : 0;
  if (!plausible(median)) {
    plan.advance_cdeg = last_advance_cdeg_;
    return;
  }
  int sum = 0;
  int counted = 0;
  int large = 0;
  int large_at = 0;
  for (int i = 0; i < gaps.count; ++i) {
    const int gap_cdeg = gaps.cdeg[i];
    if (gap_cdeg > 0 && gap_cdeg <= 2 * median) {
      sum += gap_cdeg;
      ++counted;
    } else if (gap_cdeg > 0 && gap_cdeg < kTurnCdeg - 2 * median) {
      // A gap near a full revolution is a small step back by encoder jitter, and is excluded here.
      ++large;
      large_at = i;
    }
  }
  keep(static_cast<double>(sum) / counted, plan);
  if (large == 1 && gaps.count >= 4) {
    pass_view_gap(plan, gaps.group_after[large_at], gaps.cdeg[large_at]);
  }
}

void Motor::keep(double advance_cdeg, PacketPlan& plan) {
  plan.advance_cdeg = advance_cdeg;
  last_advance_cdeg_ = advance_cdeg;
  const bool follows = std::abs(advance_cdeg - smooth_advance_cdeg_) < 0.03 * advance_cdeg;
  smooth_advance_cdeg_ =
      follows ? smooth_advance_cdeg_ + (advance_cdeg - smooth_advance_cdeg_) / 32.0 : advance_cdeg;
}

// A packet of one group (128 beams, two returns) does not contain its own advance. The motor's
// speed is computed from the stamps and azimuths of this packet and the one before; as a speed, it
// is not affected by a lost packet between them.
void Motor::measure_by_packets(PacketPlan& plan) {
  plan.advance_cdeg = last_advance_cdeg_;
  if (!plan.group[0].valid) return;
  const std::int64_t ahead_us =
      static_cast<std::int64_t>(plan.toh_us) - static_cast<std::int64_t>(last_toh_us_);
  const int turned_cdeg = (plan.group[0].azimuth_cdeg - last_azimuth_cdeg_ + kTurnCdeg) % kTurnCdeg;
  const bool known = last_azimuth_cdeg_ >= 0 && ahead_us > 0;
  last_azimuth_cdeg_ = plan.group[0].azimuth_cdeg;
  last_toh_us_ = plan.toh_us;
  if (!known) return;
  const double advance_cdeg = turned_cdeg * group_ns_ / (1e3 * static_cast<double>(ahead_us));
  const bool jump = last_advance_cdeg_ > 0.0 && advance_cdeg > 1.8 * last_advance_cdeg_;
  if (!plausible(advance_cdeg) || jump) return;
  plan.advance_cdeg = advance_cdeg;
  last_advance_cdeg_ = advance_cdeg;
}

// A restricted field of view shows as one large gap forward within a packet. The sensor rotates
// through that gap, so the groups behind it are later by the time that takes.
void Motor::pass_view_gap(PacketPlan& plan, int first_group, int gap_cdeg) const {
  plan.gap_before_group = first_group;
  const double skipped_groups = gap_cdeg / smooth_advance_cdeg_ - 1.0;
  const std::int64_t skipped_ns = std::llround(skipped_groups * group_ns_);
  for (int g = first_group; g < plan.groups; ++g) plan.group[g].offset_ns += skipped_ns;
  plan.duration_ns += skipped_ns;
}

}  // namespace zloam::driver
