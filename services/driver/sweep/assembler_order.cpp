// Puts the assembler's packets in order: late, duplicate and lost packets, and steps of the
// sensor's clock.

#include <algorithm>
#include <cmath>
#include <cstdlib>

#include "driver/sweep/assembler.hpp"
#include "driver/sweep/azimuth.hpp"

namespace zloam::driver {
namespace {

// A packet older than the newest by more than this is not late: the sensor's clock was set back.
constexpr std::int64_t kClockStepUs = 500'000;
constexpr std::int64_t kHalfHourUs = 1'800'000'000;
// Two clocks drift apart by less than one part in this.
constexpr std::int64_t kClocksAgree = 1000;
// After this many packets in a row that are older than the newest, the clock was set back as well.
constexpr int kLateInARow = 16;
// A longer wait by the receiver's clock means that the receiver's clock was set meanwhile.
constexpr std::int64_t kLongestOutageNs = 86'400'000'000'000;
// Azimuths this close to a known edge of a restricted field of view count as that edge.
constexpr int kViewEdgeCdeg = 100;
// The time across a view's gap may be longer than expected by one part in this.
constexpr std::int64_t kViewGapTolerance = 32;
// A smaller gap between packets is never taken for that of a restricted field of view.
constexpr int kLeastViewGapCdeg = 1000;
// Packets missing at the same azimuths in this many successive revolutions are the view's gap.
constexpr int kViewGapTurns = 5;
// The same where the decoder expects the gap, and only its time was wrong.
constexpr int kExpectedGapTurns = 2;

}  // namespace

/// The stream's first two packets may have arrived in reverse order; waits for the second. Stamps
/// that are further apart have no order: one of them is damaged, or from before the clock was set.
void SweepAssembler::begin(const Packet& packet) {
  if (!held_.empty()) {
    const std::int64_t apart_us = toh_difference_us(packet.tail.toh_us, held_.front().tail.toh_us);
    if (std::abs(apart_us) > kClockStepUs) {
      process_first_held();
      order(packet);
      return;
    }
  }
  if (hold(packet) && held_.size() > 1) process_first_held();
}

void SweepAssembler::process_first_held() {
  const Held first = held_.front();
  held_.erase(held_.begin());
  const std::int64_t received_ns =
      config_.first_received_ns != 0 ? config_.first_received_ns : first.received_ns;
  clock_.anchor(sensor_ns_, first.tail.toh_us, received_ns,
                decoder_->packet_period_ns(first.tail.mode));
  started_ = true;
  restart({first.payload, first.tail, first.received_ns}, 0);
  release_contiguous();
}

/// Time since the packet before by the receiver's clock; 0: unknown.
std::int64_t SweepAssembler::received_after_us(const Packet& packet) const {
  if (packet.received_ns == 0 || last_received_ns_ == 0) return 0;
  const std::int64_t waited_ns = packet.received_ns - last_received_ns_;
  return waited_ns > kLongestOutageNs ? 0 : waited_ns / 1000;
}

/// The same by the sensor's stamps. They begin again with each hour: after a longer silence the
/// receiver's clock tells the whole hours. A small step forward is no silence: that clock was set.
std::int64_t SweepAssembler::stamped_after_us(const Packet& packet) const {
  const std::int64_t by_stamps_us = toh_difference_us(packet.tail.toh_us, last_toh_us_);
  const std::int64_t waited_us = received_after_us(packet);
  const bool small = by_stamps_us >= 0 && by_stamps_us <= kClockStepUs;
  if (small || waited_us <= kHalfHourUs) return by_stamps_us;
  const std::int64_t hours = (waited_us - by_stamps_us + kHalfHourUs) / (2 * kHalfHourUs);
  return by_stamps_us + hours * 2 * kHalfHourUs;
}

void SweepAssembler::order(const Packet& packet) {
  // Stamps from before a long silence have no order with later ones.
  if (received_after_us(packet) > kHalfHourUs) release_held(0);
  const std::int64_t ahead_us = stamped_after_us(packet);
  if (clock_stepped(packet, ahead_us)) {
    suspect_step(packet);
    return;
  }
  drop_suspect();
  if (ahead_us <= 0) {
    count_overtaken(packet.tail.toh_us, ahead_us);
  } else if (contiguous(packet)) {
    if (!held_.empty()) ++counts_.reordered;
    process(packet, 1000 * ahead_us);
    release_contiguous();
  } else if (hold(packet)) {
    release_held(static_cast<std::size_t>(std::max(config_.reorder_packets, 0)));
  }
}

/// Whether the sensor's clock was set. The sensor's stamps decide: a small step forward is accepted
/// whatever the host's clock says. A large one means lost packets, unless by the host's clock the
/// packet arrived before it was sent.
bool SweepAssembler::clock_stepped(const Packet& packet, std::int64_t ahead_us) const {
  if (ahead_us < -kClockStepUs) return true;
  if (ahead_us < 0 && late_in_a_row_ >= kLateInARow) return true;
  if (ahead_us <= kClockStepUs || packet.received_ns == 0 || last_received_ns_ == 0) return false;
  const std::int64_t waited_us = (packet.received_ns - last_received_ns_) / 1000;
  if (received_after_us(packet) > kHalfHourUs) {
    // The hours were counted by the wait: a sensor that was on meanwhile agrees with it.
    return std::abs(ahead_us - waited_us) > kClockStepUs + waited_us / kClocksAgree;
  }
  const bool host_went_back = waited_us < 0;
  const bool waited_as_long = ahead_us - waited_us <= kClockStepUs;
  const bool delayed_less =
      clock_.delay_ns(sensor_ns_ + 1000 * ahead_us, packet.received_ns) > -1000 * kClockStepUs;
  return !host_went_back && !waited_as_long && !delayed_less;
}

/// A single packet with a deviating stamp may be damaged, or from before the clock was set. Two
/// packets that agree confirm the new time.
void SweepAssembler::suspect_step(const Packet& packet) {
  if (!suspect_.empty()) {
    const std::int64_t ahead_us =
        toh_difference_us(packet.tail.toh_us, suspect_.front().tail.toh_us);
    if (ahead_us == 0) {
      ++counts_.duplicate;
      return;
    }
    if (std::abs(ahead_us) <= kClockStepUs) {
      const Held other = held_copy(packet);
      const Held first = ahead_us > 0 ? suspect_.front() : other;
      const Held second = ahead_us > 0 ? other : suspect_.front();
      if (ahead_us < 0) ++counts_.reordered;
      suspect_ = {first};
      confirm_step();
      order({second.payload, second.tail, second.received_ns});
      return;
    }
  }
  drop_suspect();
  suspect_.push_back(held_copy(packet));
}

void SweepAssembler::confirm_step() {
  release_held(0);
  ++counts_.clock_steps;
  const Held first = suspect_.front();
  suspect_.clear();
  const Packet packet{first.payload, first.tail, first.received_ns};
  const std::int64_t ahead_ns = elapsed_ns(packet);
  const std::int64_t by_stamps_ns = 1000 * stamped_after_us(packet);
  restart(packet, ahead_ns);
  sweep_.sensor_clock_step_ns += by_stamps_ns - ahead_ns;
}

/// Time from the packet before to one whose stamp is on another time base: the receiver's waiting
/// time where it is plausible, else the expected interval.
std::int64_t SweepAssembler::elapsed_ns(const Packet& packet) const {
  if (packet.received_ns == 0 || last_received_ns_ == 0) return expected_ahead_ns_;
  const std::int64_t waited_ns = packet.received_ns - last_received_ns_;
  return waited_ns > kLongestOutageNs ? expected_ahead_ns_
                                      : std::max(waited_ns, expected_ahead_ns_);
}

void SweepAssembler::drop_suspect() {
  if (suspect_.empty()) return;
  ++counts_.late;
  suspect_.clear();
}

/// Counts a packet older than those already decoded: a duplicate, or one that arrived too late and
/// is then no longer counted as lost.
void SweepAssembler::count_overtaken(std::uint32_t toh_us, std::int64_t ahead_us) {
  const std::size_t known = std::min(recent_, recent_toh_us_.size());
  const auto end = recent_toh_us_.begin() + static_cast<std::ptrdiff_t>(known);
  if (ahead_us == 0 || std::find(recent_toh_us_.begin(), end, toh_us) != end) {
    ++counts_.duplicate;
    return;
  }
  ++counts_.late;
  ++late_in_a_row_;
  const std::int64_t at_ns = sensor_ns_ + 1000 * ahead_us;
  for (Gap& gap : gaps_) {
    if (gap.missing == 0 || at_ns <= gap.from_ns || at_ns >= gap.to_ns) continue;
    --gap.missing;
    --counts_.lost;
    return;
  }
}

SweepAssembler::Held SweepAssembler::held_copy(const Packet& packet) {
  return {{packet.payload.begin(), packet.payload.end()}, packet.tail, packet.received_ns};
}

/// Latest time from the packet before to this one, if none is missing between them. The time across
/// a gap of the field of view within one of them is known only as well as the motor's speed, but
/// their azimuths show whether one follows the other.
std::int64_t SweepAssembler::due_ns(const PacketTail& tail) const {
  const std::int64_t expected_ns = expected_ahead_ns_ + tail.view_gap_ns;
  const bool follows =
      apart(last_azimuth_cdeg_, tail.first_azimuth_cdeg) < 2.0 * last_advance_cdeg_;
  if (!follows) return expected_ns;
  return expected_ns + (expected_gap_ns_ + tail.view_gap_ns) / kViewGapTolerance;
}

double SweepAssembler::rotation_cdeg(std::int64_t time_ns) const {
  return last_advance_cdeg_ * static_cast<double>(time_ns) / decoder_->shape().group_ns;
}

/// Whether the motor made no whole revolution from the packet before to this one, which is
/// ahead_ns later.
bool SweepAssembler::within_a_turn(const PacketTail& tail, std::int64_t ahead_ns) const {
  return rotation_cdeg(ahead_ns) <
         ahead(last_azimuth_cdeg_, tail.first_azimuth_cdeg) + kHalfTurnCdeg;
}

bool SweepAssembler::across_view_gap(const PacketTail& tail, std::int64_t ahead_ns) const {
  if (view_gap_from_cdeg_ < 0 || !within_a_turn(tail, ahead_ns)) return false;
  return apart(last_azimuth_cdeg_, view_gap_from_cdeg_) < kViewEdgeCdeg &&
         apart(tail.first_azimuth_cdeg, view_gap_to_cdeg_) < kViewEdgeCdeg;
}

/// Whether packets seem to be missing at the same azimuths in each of the last revolutions. That is
/// no loss but the gap of a restricted field of view that lies between two packets; its edges are
/// then known. They are compared with those of the first of these revolutions: losses that a timer
/// causes drift.
bool SweepAssembler::lost_again(const PacketTail& tail, std::int64_t ahead_ns) {
  const int gap_cdeg = ahead(last_azimuth_cdeg_, tail.first_azimuth_cdeg);
  if (gap_cdeg < kLeastViewGapCdeg || !within_a_turn(tail, ahead_ns)) return false;
  const bool again = lost_in_a_row_ > 0 &&
                     apart(last_azimuth_cdeg_, lost_from_cdeg_) < kViewEdgeCdeg &&
                     apart(tail.first_azimuth_cdeg, lost_to_cdeg_) < kViewEdgeCdeg &&
                     rotation_cdeg(sensor_ns_ - lost_at_ns_) < kTurnCdeg + kHalfTurnCdeg;
  lost_at_ns_ = sensor_ns_;
  if (!again) {
    lost_in_a_row_ = 1;
    lost_from_cdeg_ = last_azimuth_cdeg_;
    lost_to_cdeg_ = tail.first_azimuth_cdeg;
    return false;
  }
  if (++lost_in_a_row_ < (expected_gap_ns_ > 0 ? kExpectedGapTurns : kViewGapTurns)) return false;
  view_gap_from_cdeg_ = lost_from_cdeg_;
  view_gap_to_cdeg_ = lost_to_cdeg_;
  return true;
}

/// A packet from within the gap of the field of view shows that there is none.
void SweepAssembler::forget_seen_gap(const PacketTail& tail) {
  if (view_gap_from_cdeg_ < 0) return;
  const int inside_cdeg = ahead(view_gap_from_cdeg_, tail.first_azimuth_cdeg);
  const int gap_cdeg = ahead(view_gap_from_cdeg_, view_gap_to_cdeg_);
  if (inside_cdeg >= kViewEdgeCdeg && inside_cdeg + kViewEdgeCdeg <= gap_cdeg) {
    view_gap_from_cdeg_ = -1;
  }
}

bool SweepAssembler::contiguous(const Packet& packet) const {
  const std::int64_t ahead_ns = 1000 * stamped_after_us(packet);
  return ahead_ns < due_ns(packet.tail) + decoder_->packet_period_ns(packet.tail.mode) / 2 ||
         across_view_gap(packet.tail, ahead_ns);
}

/// Buffers the packet in time order; false if it is there already.
bool SweepAssembler::hold(const Packet& packet) {
  const auto place = std::find_if(held_.begin(), held_.end(), [&](const Held& held) {
    return toh_difference_us(held.tail.toh_us, packet.tail.toh_us) >= 0;
  });
  if (place != held_.end()) {
    if (place->tail.toh_us == packet.tail.toh_us) {
      ++counts_.duplicate;
      return false;
    }
    ++counts_.reordered;
  }
  held_.insert(place, held_copy(packet));
  return true;
}

void SweepAssembler::release_held(std::size_t keep) {
  while (held_.size() > keep) {
    const Held held = held_.front();
    held_.erase(held_.begin());
    const Packet packet{held.payload, held.tail, held.received_ns};
    process(packet, 1000 * stamped_after_us(packet));
    release_contiguous();
  }
}

std::optional<std::int64_t> SweepAssembler::epoch_ns(std::int64_t toh_ns) const {
  if (!started_) return std::nullopt;
  const std::int64_t ahead_ns =
      1000 * toh_difference_us(static_cast<std::uint32_t>(toh_ns / 1000), last_toh_us_) +
      toh_ns % 1000;
  return clock_.to_epoch_ns(sensor_ns_ + ahead_ns) + config_.stamp_offset_ns;
}

std::int64_t SweepAssembler::ahead_of_utc_ns() const {
  if (config_.clock_mode != ClockMode::kUtc || !started_ || last_received_ns_ == 0) return 0;
  return clock_.to_epoch_ns(sensor_ns_) - resolve_hour_ns(last_toh_us_, last_received_ns_);
}

void SweepAssembler::release_contiguous() {
  while (!held_.empty()) {
    const Held held = held_.front();
    const Packet packet{held.payload, held.tail, held.received_ns};
    if (!contiguous(packet)) return;
    held_.erase(held_.begin());
    process(packet, 1000 * stamped_after_us(packet));
  }
}

/// Starts a new sweep with this packet, ahead_ns after the packet before.
void SweepAssembler::restart(const Packet& packet, std::int64_t ahead_ns) {
  close(false);
  view_gap_from_cdeg_ = -1;
  lost_in_a_row_ = 0;
  gaps_ = {};
  expected_ahead_ns_ = ahead_ns;
  expected_gap_ns_ = 0;
  process(packet, ahead_ns);
}

std::int64_t SweepAssembler::missing_before(const Packet& packet, std::int64_t ahead_ns) const {
  const std::int64_t period_ns = decoder_->packet_period_ns(packet.tail.mode);
  const std::int64_t beyond_ns = ahead_ns - due_ns(packet.tail) + period_ns / 2;
  if (period_ns <= 0 || beyond_ns < period_ns) return 0;
  if (across_view_gap(packet.tail, ahead_ns)) return 0;
  return beyond_ns / period_ns;
}

}  // namespace zloam::driver
