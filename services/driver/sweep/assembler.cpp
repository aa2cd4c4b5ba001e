#include "driver/sweep/assembler.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "driver/sweep/azimuth.hpp"

namespace zloam::driver {
namespace {

// A step back of up to 10 degrees is jitter of the encoder, not a full revolution forward.
constexpr int kJitterCdeg = 1000;
// Below a rotation of 10 degrees, the advance within a packet measures the period better.
constexpr int kMeasurableTurnCdeg = 1000;
// Added before truncation, so that the result is rounded to nearest.
constexpr double kToNearest = 0.5;
// Points by which a sweep's buffers grow at least.
constexpr std::size_t kRoomStep = 512;

/// Limited to 32-bit nanoseconds: a motor that hardly turns takes longer.
std::uint32_t period_from(double period_ns) {
  constexpr double kLongestNs = std::numeric_limits<std::uint32_t>::max();
  return static_cast<std::uint32_t>(std::llround(std::min(period_ns, kLongestNs)));
}

/// Of the packets lost before a sweep's first group, those that belong to it. One that contained the
/// seam belongs to both sweeps.
struct LostBehindSeam {
  std::uint32_t wholly = 0;
  std::uint32_t partly = 0;
};

LostBehindSeam lost_behind_seam(std::int64_t lost, int phase_cdeg, double advance_cdeg,
                                double packet_cdeg) {
  if (lost == 0 || packet_cdeg <= 0.0) return {0, static_cast<std::uint32_t>(lost)};
  const auto most = static_cast<double>(lost);
  const double wholly = std::floor(phase_cdeg / packet_cdeg);
  const double partly = std::ceil((phase_cdeg - advance_cdeg) / packet_cdeg);
  return {static_cast<std::uint32_t>(std::clamp(wholly, 0.0, most)),
          static_cast<std::uint32_t>(std::clamp(partly, 0.0, most))};
}

}  // namespace

std::vector<std::pair<std::string_view, std::uint64_t>> PacketCounts::named() const {
  return {{"packets_received", received},
          {"packets_decoded", decoded},
          {"points", points},
          {"packets_short", too_short},
          {"packets_foreign", foreign},
          {"packets_unknown_model", unknown_model},
          {"packets_model_mismatch", model_mismatch},
          {"packets_unknown_mode", unknown_mode},
          {"packets_bad_time", bad_time},
          {"packets_duplicate", duplicate},
          {"packets_late", late},
          {"packets_lost", lost},
          {"packets_reordered", reordered},
          {"blocks_bad", bad_blocks},
          {"clock_steps", clock_steps},
          {"host_clock_steps", host_clock_steps},
          {"points_masked", points_masked}};
}

SweepAssembler::SweepAssembler(std::unique_ptr<PacketDecoder> decoder,
                               const AssemblerConfig& config)
    : config_(config),
      mask_(config.mask),
      seam_cdeg_(wrapped(std::llround(100.0 * config.seam_azimuth_deg))),
      decoder_(std::move(decoder)),
      clock_(config.clock_mode) {}

bool SweepAssembler::accepted(const PacketTail& tail) {
  switch (tail.reject) {
    case Reject::kNone:
      return true;
    case Reject::kShort:
      ++counts_.too_short;
      return false;
    case Reject::kForeign:
      ++counts_.foreign;
      return false;
    case Reject::kUnknownModel:
      ++counts_.unknown_model;
      return false;
    case Reject::kModelMismatch:
      ++counts_.model_mismatch;
      return false;
    case Reject::kUnknownMode:
      ++counts_.unknown_mode;
      return false;
    case Reject::kBadTime:
      ++counts_.bad_time;
      return false;
  }
  return false;
}

void SweepAssembler::add(std::span<const std::uint8_t> payload, std::int64_t received_ns) {
  ++counts_.received;
  const PacketTail tail = decoder_->tail(payload);
  if (!accepted(tail)) return;
  const Packet packet{payload, tail, received_ns};
  started_ ? order(packet) : begin(packet);
}

void SweepAssembler::process(const Packet& packet, std::int64_t ahead_ns) {
  forget_seen_gap(packet.tail);
  std::int64_t missing = missing_before(packet, ahead_ns);
  if (missing > 0 && lost_again(packet.tail, ahead_ns)) missing = 0;
  lost_before_ = missing;
  counts_.lost += static_cast<std::uint64_t>(missing);
  if (open_) sweep_.packets_lost += static_cast<std::uint32_t>(missing);
  if (missing > 0) {
    gaps_[next_gap_++ % gaps_.size()] = {sensor_ns_, sensor_ns_ + ahead_ns, missing};
  }
  recent_toh_us_[recent_++ % recent_toh_us_.size()] = packet.tail.toh_us;
  late_in_a_row_ = 0;

  sensor_ns_ += ahead_ns;
  last_toh_us_ = packet.tail.toh_us;
  last_received_ns_ = packet.received_ns;
  const PacketPlan plan = decoder_->plan(packet.payload, packet.tail.mode);
  clock_.observe(sensor_ns_, packet.received_ns, plan.duration_ns);
  if (const std::int64_t step_ns = clock_.take_host_step_ns(); step_ns != 0) {
    ++counts_.host_clock_steps;
    sweep_.host_clock_step_ns += step_ns;
  }
  counts_.bad_blocks += static_cast<std::uint64_t>(plan.bad_blocks);
  ++counts_.decoded;
  expected_ahead_ns_ = plan.next_ns;
  expected_gap_ns_ =
      std::max<std::int64_t>(0, plan.next_ns - decoder_->packet_period_ns(plan.mode));
  packet_counted_ = false;
  decode_groups(plan, sensor_ns_, packet.received_ns);
}

// The next three functions run for each of a packet's twelve groups, where the calls would take
// half of the time.

/// Counts the packet once in each sweep that contains groups of it.
__attribute__((always_inline)) inline void SweepAssembler::count_packet(const PacketPlan& plan) {
  if (packet_counted_) return;
  packet_counted_ = true;
  if (sweep_.packets++ == 0) sweep_.first_packet_toh_us = plan.toh_us;
  sweep_.last_packet_toh_us = plan.toh_us;
  sweep_.packet_period_ns = static_cast<std::uint32_t>(decoder_->packet_period_ns(plan.mode));
}

/// Cuts before this group if it has passed the seam, or if the last cut is too long ago.
__attribute__((always_inline)) inline void SweepAssembler::advance_to(const PacketPlan& plan,
                                                                      int group,
                                                                      std::int64_t time_ns) {
  const int phase_cdeg = ahead(seam_cdeg_, plan.group[group].azimuth_cdeg);
  if (!open_) {
    open(time_ns, phase_cdeg, false);
    return;
  }
  const int forward_cdeg = ahead(phase_cdeg_, phase_cdeg);
  const bool backwards = forward_cdeg > kTurnCdeg - kJitterCdeg;
  // Rotation expected since the last group, multiplied by the time of a group to save a division.
  const double expected = plan.advance_cdeg * static_cast<double>(time_ns - last_group_ns_);
  const bool missed_turn =
      expected > (forward_cdeg + kHalfTurnCdeg) * decoder_->shape().group_ns && !backwards;
  const bool at_seam = (!backwards && phase_cdeg < phase_cdeg_) || missed_turn;
  if (at_seam || time_ns - first_group_ns_ > config_.guard_ns) {
    cut(plan, time_ns, phase_cdeg, at_seam);
    return;
  }
  last_group_ns_ = time_ns;
  if (backwards) return;
  turned_cdeg_ += forward_cdeg;
  phase_cdeg_ = phase_cdeg;
}

/// Collects the groups up to a cut, so that one call decodes them instead of twelve.
__attribute__((always_inline)) inline void SweepAssembler::place_group(int group,
                                                                       std::int64_t time_ns) {
  const StreamShape& shape = decoder_->shape();
  // Rounded by hand, as the value is never negative: a division and std::round would be a tenth of
  // the decoding time.
  const auto groups = static_cast<std::int64_t>(
      static_cast<double>(time_ns - first_group_ns_) * shape.groups_per_ns + kToNearest);
  const std::int64_t by_angle =
      (std::int64_t{phase_cdeg_} * shape.columns_per_turn + kHalfTurnCdeg) / kTurnCdeg;
  const auto column = static_cast<std::uint16_t>(std::min<std::int64_t>(
      shape.columns_per_turn > 0 ? by_angle : groups * shape.columns_per_group, 65000));
  placed_[placed_count_++] = {group, static_cast<std::uint32_t>(time_ns - base_ns_), column};
}

void SweepAssembler::decode_groups(const PacketPlan& plan, std::int64_t packet_ns,
                                   std::int64_t received_ns) {
  const std::int64_t group_span_ns = decoder_->shape().group_span_ns;
  for (int g = 0; g < plan.groups; ++g) {
    if (!plan.group[g].valid) continue;
    std::int64_t time_ns = packet_ns + plan.group[g].offset_ns;
    // The motor may pass the gap of a restricted view faster than estimated, or a stamp may be
    // damaged: delay the group to keep the points in time order. A group's firings take less time
    // than the interval between groups, so the delay wears off.
    if (open_) time_ns = std::max(time_ns, last_group_ns_ + group_span_ns);
    if (plan.gap_before_group == g && g > 0) {
      view_gap_from_cdeg_ = plan.group[g - 1].azimuth_cdeg;
      view_gap_to_cdeg_ = plan.group[g].azimuth_cdeg;
    }
    advance_to(plan, g, time_ns);
    lost_before_ = 0;
    count_packet(plan);
    sweep_.return_mode = plan.mode;
    sweep_.last_packet_ns = received_ns;
    place_group(g, time_ns);
    last_azimuth_cdeg_ = plan.group[g].azimuth_cdeg;
  }
  append_placed(plan);
  last_advance_cdeg_ = plan.advance_cdeg;
}

void SweepAssembler::cut(const PacketPlan& plan, std::int64_t time_ns, int phase_cdeg,
                         bool at_seam) {
  append_placed(plan);
  const std::int64_t lost = at_seam ? lost_before_ : 0;
  const double advance_cdeg = plan.advance_cdeg;
  const double packet_cdeg = advance_cdeg *
                             static_cast<double>(decoder_->packet_period_ns(plan.mode)) /
                             decoder_->shape().group_ns;
  const LostBehindSeam behind = lost_behind_seam(lost, phase_cdeg, advance_cdeg, packet_cdeg);
  sweep_.packets_lost -= behind.wholly;
  close(at_seam);
  open(time_ns, phase_cdeg, at_seam);
  sweep_.packets_lost = behind.partly;
}

/// Makes room for this many more points, plus one. The capacity for a whole revolution is reserved
/// at once; elements are initialized in steps, and only those beyond what these buffers held in an
/// earlier sweep.
void SweepAssembler::make_room(const PacketPlan& plan, std::size_t points) {
  const std::size_t group = decoder_->most_points_per_group(plan.mode);
  const double groups = plan.advance_cdeg > 3.0 ? kTurnCdeg / plan.advance_cdeg : 0.0;
  const std::size_t turn = static_cast<std::size_t>(1.01 * groups) * group + 2 * group;
  sweep_.points.reserve(turn);
  sweep_.columns.reserve(turn);
  const std::size_t wanted = filled_ + std::max(points + 1, kRoomStep);
  sweep_.points.resize(std::max(sweep_.points.size(), wanted));
  sweep_.columns.resize(sweep_.points.size());
}

void SweepAssembler::append_placed(const PacketPlan& plan) {
  const std::size_t groups = std::exchange(placed_count_, 0);
  if (groups == 0) return;
  const bool first = filled_ == 0;
  const std::size_t most = groups * decoder_->most_points_per_group(plan.mode);
  if (sweep_.points.size() - filled_ <= most) make_room(plan, most);
  Point* const out = sweep_.points.data() + filled_;
  std::uint16_t* const columns = sweep_.columns.data() + filled_;
  std::size_t count = decoder_->decode_groups(plan, std::span(placed_).first(groups), out, columns);
  if (mask_.active()) {
    const std::size_t kept = mask_.apply(out, columns, count);
    counts_.points_masked += count - kept;
    count = kept;
  }
  if (first && count > 0) {
    const std::uint32_t shift_ns = out[0].time_ns;
    for (std::size_t i = 0; i < count; ++i) out[i].time_ns -= shift_ns;
    base_ns_ += shift_ns;
  }
  filled_ += count;
  counts_.points += count;
}

void SweepAssembler::open(std::int64_t time_ns, int phase_cdeg, bool at_seam) {
  clock_.advance(time_ns);
  if (!spare_.empty()) {
    std::swap(sweep_.points, spare_.back().points);
    std::swap(sweep_.columns, spare_.back().columns);
    spare_.pop_back();
  }
  sweep_.columns.resize(sweep_.points.size());
  sweep_.packets = 0;
  sweep_.packets_lost = 0;
  open_ = true;
  began_at_seam_ = at_seam;
  packet_counted_ = false;
  filled_ = 0;
  base_ns_ = time_ns;
  first_group_ns_ = time_ns;
  last_group_ns_ = time_ns;
  phase_cdeg_ = phase_cdeg;
  turned_cdeg_ = 0;
}

std::uint32_t SweepAssembler::measured_period_ns() const {
  const auto time_ns = static_cast<double>(last_group_ns_ - first_group_ns_);
  if (turned_cdeg_ >= kMeasurableTurnCdeg && time_ns > 0.0) {
    return period_from(time_ns * kTurnCdeg / turned_cdeg_);
  }
  if (last_period_ns_ != 0 || last_advance_cdeg_ <= 0.0) return last_period_ns_;
  return period_from(decoder_->shape().group_ns * kTurnCdeg / last_advance_cdeg_);
}

void SweepAssembler::close(bool at_seam) {
  if (!open_) return;
  open_ = false;
  sweep_.points.resize(filled_);
  sweep_.columns.resize(filled_);
  const std::int64_t first_ns = filled_ > 0 ? base_ns_ : first_group_ns_;
  sweep_.stamp_ns = clock_.to_epoch_ns(first_ns) + config_.stamp_offset_ns;
  last_period_ns_ = measured_period_ns();
  sweep_.period_ns = last_period_ns_;
  sweep_.rings = decoder_->shape().rings;
  sweep_.model = decoder_->shape().model;
  sweep_.clock_source = config_.clock_source;
  sweep_.complete = began_at_seam_ && at_seam && sweep_.packets_lost == 0;
  ready_.push_back(std::move(sweep_));
  sweep_ = {};
}

void SweepAssembler::flush() {
  if (!started_ && !held_.empty()) process_first_held();
  release_held(0);
  if (!suspect_.empty()) confirm_step();
  close(false);
}

bool SweepAssembler::take(DecodedSweep& out) {
  if (ready_.empty()) return false;
  spare_.push_back(std::move(out));
  out = std::move(ready_.front());
  ready_.erase(ready_.begin());
  return true;
}

}  // namespace zloam::driver
