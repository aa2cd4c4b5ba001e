#include "driver/decoder/motor.hpp"

#include <algorithm>
#include <cmath>

namespace zloam::driver {
namespace {

constexpr double kMinRpm = 180.0;
constexpr double kMaxRpm = 1500.0;

// After this much rotation without a gap the field of view is a full one.
constexpr int kFullViewCdeg = 2 * kTurnCdeg;

int gap_between(const Group& before, const Group& after) {
  const int gap_cdeg = after.azimuth_cdeg - before.azimuth_cdeg;
  return gap_cdeg < 0 ? gap_cdeg + kTurnCdeg : gap_cdeg;
}

/// Nothing of a small step back by encoder jitter.
int forward_cdeg(int gap_cdeg) { return gap_cdeg < kHalfTurnCdeg ? gap_cdeg : 0; }

double advance_at(double rpm, double group_ns) { return rpm / 60.0 * kTurnCdeg * group_ns * 1e-9; }

}  // namespace

Motor::Motor(double group_ns, Stamp stamp)
    : group_ns_(group_ns),
      stamp_(stamp),
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
  if (const double even_cdeg = even_advance_cdeg(plan); even_cdeg > 0.0) {
    keep(even_cdeg, plan);
    follow(plan, false);
  } else {
    measure_uneven(plan);
  }
}

std::int64_t Motor::view_gap_ns(const PacketPlan& plan) const {
  if (plan.groups == 1 || smooth_advance_cdeg_ <= 0.0 || even_advance_cdeg(plan) > 0.0) return 0;
  const Spread spread = spread_of(plan);
  return is_view_gap(spread) ? passed_ns(spread.view_gap_cdeg) : 0;
}

/// Fast path for nearly all packets: if the gaps are this even, all are plausible. 0: they are not.
double Motor::even_advance_cdeg(const PacketPlan& plan) const {
  int sum = 0;
  int least = kTurnCdeg;
  int greatest = 0;
  for (int g = 1; g < plan.groups; ++g) {
    if (!plan.group[g - 1].valid || !plan.group[g].valid) return 0.0;
    const int gap_cdeg = gap_between(plan.group[g - 1], plan.group[g]);
    sum += gap_cdeg;
    least = std::min(least, gap_cdeg);
    greatest = std::max(greatest, gap_cdeg);
  }
  if (!plausible(least) || !plausible(greatest) || greatest > 2 * least) return 0.0;
  return static_cast<double>(sum) / (plan.groups - 1);
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

/// The median of the plausible gaps; 0 if most gaps are not. Of two gaps, one may be the view's.
int Motor::typical_cdeg(const Gaps& gaps) const {
  std::array<int, kMostGroups> good{};
  int count = 0;
  for (int i = 0; i < gaps.count; ++i) {
    if (plausible(gaps.cdeg[i])) good[count++] = gaps.cdeg[i];
  }
  if (count == 0 || 2 * count < gaps.count) return 0;
  const auto middle = good.begin() + count / 2;
  std::nth_element(good.begin(), middle, good.begin() + count);
  return *middle;
}

Motor::Spread Motor::spread_of(const PacketPlan& plan) const {
  Spread spread;
  const Gaps gaps = gaps_of(plan);
  const int typical = typical_cdeg(gaps);
  for (int i = 0; typical > 0 && i < gaps.count; ++i) {
    const int gap_cdeg = gaps.cdeg[i];
    if (gap_cdeg > 0 && gap_cdeg <= 2 * typical) {
      spread.sum_cdeg += gap_cdeg;
      ++spread.counted;
    } else if (gap_cdeg > 0 && gap_cdeg < kTurnCdeg - 2 * typical) {
      // A gap near a full revolution is a small step back by encoder jitter, and is excluded here.
      ++spread.large;
      spread.view_group = gaps.group_after[i];
      spread.view_gap_cdeg = gap_cdeg;
    }
  }
  return spread;
}

/// Whether the packet's large gap is that of a restricted field of view. In a full view there is
/// none: the packet's first or last azimuth is damaged. A view that is restricted during a run is
/// known from its second gap on.
bool Motor::is_view_gap(const Spread& spread) const {
  return spread.large == 1 && since_gap_cdeg_ < kFullViewCdeg;
}

/// Adds up the rotation since the last gap, within a packet or between two.
void Motor::follow(const PacketPlan& plan, bool gap_within) {
  int first = 0;
  while (first < plan.groups && !plan.group[first].valid) ++first;
  if (first == plan.groups) return;
  int last = plan.groups - 1;
  while (!plan.group[last].valid) --last;
  const int since_cdeg = last_.valid ? gap_between(last_, plan.group[first]) : 0;
  const bool gap_before =
      since_cdeg > 2.0 * plan.advance_cdeg && since_cdeg < kTurnCdeg - 2.0 * plan.advance_cdeg;
  const int within_cdeg = gap_between(plan.group[first], plan.group[last]);
  const int turned_cdeg = since_gap_cdeg_ + forward_cdeg(since_cdeg) + forward_cdeg(within_cdeg);
  since_gap_cdeg_ = gap_within || gap_before ? 0 : std::min(turned_cdeg, kFullViewCdeg);
  last_ = plan.group[last];
}

void Motor::measure_uneven(PacketPlan& plan) {
  const Spread spread = spread_of(plan);
  // One gap alone is rounded by up to a twentieth, which would be milliseconds across a view's gap.
  if (spread.counted > 1 || (spread.counted == 1 && smooth_advance_cdeg_ <= 0.0)) {
    keep(static_cast<double>(spread.sum_cdeg) / spread.counted, plan);
  } else {
    plan.advance_cdeg = last_advance_cdeg_;
  }
  if (is_view_gap(spread)) pass_view_gap(plan, spread);
  follow(plan, spread.large > 0);
}

void Motor::keep(double advance_cdeg, PacketPlan& plan) {
  plan.advance_cdeg = advance_cdeg;
  last_advance_cdeg_ = advance_cdeg;
  const bool follows = std::abs(advance_cdeg - smooth_advance_cdeg_) < 0.03 * advance_cdeg;
  smooth_advance_cdeg_ =
      follows ? smooth_advance_cdeg_ + (advance_cdeg - smooth_advance_cdeg_) / 32.0 : advance_cdeg;
}

// A packet of one group (128 beams, two returns) does not contain its own advance. It is computed
// from the stamps and azimuths of this packet and its neighbour; across lost packets, or the gap of
// a restricted field of view, the number of revolutions between the two would be a guess.
void Motor::measure_by_packets(PacketPlan& plan) {
  plan.advance_cdeg = last_advance_cdeg_;
  if (!plan.group[0].valid) return;
  const std::int64_t ahead_us =
      static_cast<std::int64_t>(plan.toh_us) - static_cast<std::int64_t>(last_toh_us_);
  const int turned_cdeg = gap_between(last_, plan.group[0]);
  const double ahead_ns = 1e3 * static_cast<double>(ahead_us);
  const bool neighbours = last_.valid && ahead_ns > 0.0 && ahead_ns < 2.0 * group_ns_;
  last_ = plan.group[0];
  last_toh_us_ = plan.toh_us;
  if (!neighbours) return;
  const double advance_cdeg = turned_cdeg * group_ns_ / ahead_ns;
  if (!plausible(advance_cdeg)) return;
  plan.advance_cdeg = advance_cdeg;
  last_advance_cdeg_ = advance_cdeg;
}

/// The time in which the sensor rotates through a gap of the view, beyond that of one group.
std::int64_t Motor::passed_ns(int gap_cdeg) const {
  return std::llround((gap_cdeg / smooth_advance_cdeg_ - 1.0) * group_ns_);
}

// A restricted field of view shows as one large gap forward within a packet. The sensor rotates
// through that gap, so the groups behind it are later by the time that takes, or, if the stamp is
// the last group's, those before it earlier.
void Motor::pass_view_gap(PacketPlan& plan, const Spread& spread) const {
  plan.gap_before_group = spread.view_group;
  const std::int64_t passed = passed_ns(spread.view_gap_cdeg);
  if (stamp_ == Stamp::kLastGroup) {
    for (int g = 0; g < spread.view_group; ++g) plan.group[g].offset_ns -= passed;
    return;
  }
  for (int g = spread.view_group; g < plan.groups; ++g) plan.group[g].offset_ns += passed;
  plan.duration_ns += passed;
}

}  // namespace zloam::driver
