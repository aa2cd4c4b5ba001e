#include "driver/hesai/decoder.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "driver/decoder/azimuth_table.hpp"
#include "driver/decoder/label.hpp"
#include "driver/decoder/return_pair.hpp"
#include "driver/decoder/rings.hpp"

namespace zloam::driver::hesai {
namespace {

constexpr double kRadPerDeg = std::numbers::pi / 180.0;
constexpr double kMmPerMetre = 1e3;

int group_count(ReturnMode mode) { return kBlocksPerPacket / static_cast<int>(returns_of(mode)); }

/// The packet is stamped with the time of the last group; PacketPlan needs that of the first.
std::uint32_t first_group_toh_us(std::uint32_t toh_us, ReturnMode mode) {
  const auto before_us = static_cast<std::uint32_t>((group_count(mode) - 1) * kBlockNs / 1000);
  return earlier_toh_us(toh_us, before_us);
}

std::uint32_t raw_of(const std::uint8_t* cell) { return read_u16(cell); }

}  // namespace

Decoder::Decoder(const Header& header, const std::vector<Beam>& beams,
                 const DecodingOptions& options)
    : header_(header),
      options_(options),
      motor_(static_cast<double>(kBlockNs), Motor::Stamp::kLastGroup),
      unit_m_(static_cast<float>(header.distance_unit_mm / kMmPerMetre)),
      limits_(raw_limits(options.min_range_m, options.max_range_m,
                         header.distance_unit_mm / kMmPerMetre)) {
  std::vector<double> elevation_deg;
  elevation_deg.reserve(beams.size());
  for (const Beam& beam : beams) elevation_deg.push_back(beam.elevation_deg);
  const std::vector<std::uint16_t> rings = rings_by_elevation(elevation_deg);
  for (std::size_t i = 0; i < beams.size(); ++i) {
    const double elevation_rad = kRadPerDeg * beams[i].elevation_deg;
    lasers_.push_back(
        {std::cos(elevation_rad), elevation_rad, kRadPerDeg * beams[i].azimuth_offset_deg,
         static_cast<std::uint32_t>(static_cast<std::int64_t>(i) * laser_step_ns(header.lasers)),
         rings[i]});
  }
  shape_stream();
  if (!options.model.empty() && plain_label(options.model) != plain_label(shape_.model)) {
    contradictions_.push_back("driver.model says " + options.model + ", the packets say " +
                              shape_.model + "; decoded as the packets say");
  }
}

void Decoder::shape_stream() {
  shape_.model = label_of(header_.lasers);
  shape_.rings = static_cast<std::uint16_t>(header_.lasers);
  shape_.group_ns = static_cast<double>(kBlockNs);
  shape_.groups_per_ns = 1.0 / shape_.group_ns;
  shape_.group_span_ns = header_.lasers * laser_step_ns(header_.lasers);
  shape_.packet_period_ns = {kBlocksPerPacket * kBlockNs, kBlocksPerPacket / 2 * kBlockNs};
  const auto lasers = static_cast<std::size_t>(header_.lasers);
  shape_.most_points_per_group = {lasers, 2 * lasers};
}

void Decoder::note_once(bool& noted, std::string text) {
  if (!noted) contradictions_.push_back(std::move(text));
  noted = true;
}

void Decoder::check_options(const Tail& tail) {
  if (!options_.return_mode || tail.first_only || *options_.return_mode == tail.mode) return;
  note_once(returns_noted_,
            "driver.returns names another return mode than the packets do; decoded as the packets "
            "say: leave driver.returns at auto, or set the sensor to that mode");
}

PacketTail Decoder::tail(std::span<const std::uint8_t> payload) {
  PacketTail tail;
  const std::optional<Header> header = header_of(payload);
  if (!header) {
    tail.reject = Reject::kForeign;
    return tail;
  }
  if (!header->known() || header->lasers != header_.lasers ||
      header->distance_unit_mm != header_.distance_unit_mm) {
    note_once(other_noted_, "packets of another Hesai sensor than the " + shape_.model +
                                " that the stream began with come on the same port: they are "
                                "dropped; give each sensor a port of its own");
    tail.reject = Reject::kModelMismatch;
    return tail;
  }
  if (payload.size() != header->packet_bytes()) {
    tail.reject = payload.size() < header->packet_bytes() ? Reject::kShort : Reject::kForeign;
    return tail;
  }
  const Tail said = tail_of(payload.data(), *header);
  tail.mode = said.mode;
  tail.first_azimuth_cdeg = read_u16(block(payload.data(), 0)) % kTurnCdeg;
  if (said.mode == ReturnMode::kUnknown) {
    note_once(mode_noted_,
              "the packets name a return mode that is none of 0x33, 0x37, 0x38, 0x39, "
              "0x3B, 0x3C: set another one in the sensor");
    tail.reject = Reject::kUnknownMode;
  } else if (!said.toh_us) {
    tail.reject = Reject::kBadTime;
  } else {
    check_options(said);
    tail.toh_us = first_group_toh_us(*said.toh_us, said.mode);
    tail.view_gap_ns = motor_.view_gap_ns(groups_of(payload, said.mode));
  }
  return tail;
}

const std::uint8_t* Decoder::block(const std::uint8_t* payload, int index) const {
  return payload + kHeaderBytes + header_.block_bytes() * static_cast<std::size_t>(index);
}

/// The plan but for the motor's part.
PacketPlan Decoder::groups_of(std::span<const std::uint8_t> payload, ReturnMode mode) const {
  PacketPlan plan;
  plan.payload = payload.data();
  plan.mode = mode;
  plan.toh_us = first_group_toh_us(tail_of(payload.data(), header_).toh_us.value_or(0), mode);
  plan.groups = group_count(mode);
  plan.duration_ns = packet_period_ns(mode);
  const int blocks_per_group = kBlocksPerPacket / plan.groups;
  for (int g = 0; g < plan.groups; ++g) {
    Group& group = plan.group[static_cast<std::size_t>(g)];
    group.offset_ns = g * kBlockNs + kFirstFiringNs;
    const int azimuth_cdeg = read_u16(block(plan.payload, g * blocks_per_group));
    group.valid = azimuth_cdeg <= kTurnCdeg;
    if (group.valid) group.azimuth_cdeg = azimuth_cdeg % kTurnCdeg;
    plan.bad_blocks += group.valid ? 0 : blocks_per_group;
  }
  return plan;
}

PacketPlan Decoder::plan(std::span<const std::uint8_t> payload, ReturnMode mode) {
  PacketPlan plan = groups_of(payload, mode);
  motor_.measure(plan);
  plan.next_ns = plan.duration_ns;
  follow(plan.advance_cdeg);
  return plan;
}

void Decoder::follow(double advance_cdeg) {
  if (advance_cdeg == followed_cdeg_) return;
  followed_cdeg_ = advance_cdeg;
  const double rad_per_ns = kRadPerDeg * advance_cdeg / (100.0 * static_cast<double>(kBlockNs));
  for (std::size_t i = 0; i < lasers_.size(); ++i) {
    const Laser& laser = lasers_[i];
    const double beside_rad = laser.offset_rad + rad_per_ns * laser.time_ns;
    directions_[i] = {static_cast<float>(laser.cos_elevation * std::cos(beside_rad)),
                      static_cast<float>(laser.cos_elevation * std::sin(beside_rad)),
                      static_cast<float>(std::sin(laser.elevation_rad))};
  }
}

Point Decoder::point_of(std::size_t laser, const std::uint8_t* cell, const Frame& frame,
                        ReturnType type) const {
  const Direction& direction = directions_[laser];
  const float range_m = static_cast<float>(raw_of(cell)) * unit_m_;
  Point point;
  point.x = range_m * (direction.along * frame.cos_azimuth - direction.across * frame.sin_azimuth);
  point.y = -range_m * (direction.along * frame.sin_azimuth + direction.across * frame.cos_azimuth);
  point.z = range_m * direction.up;
  point.intensity = static_cast<float>(cell[2]);
  point.time_ns = frame.time_ns + lasers_[laser].time_ns;
  point.ring = lasers_[laser].ring;
  point.return_type = type;
  point.reserved = 0;
  return point;
}

void Decoder::put_block(const std::uint8_t* block, const Frame& frame, ReturnType type,
                        Sink& sink) const {
  const std::uint8_t* cell = block + kAzimuthBytes;
  for (std::size_t i = 0; i < lasers_.size(); ++i, cell += kCellBytes) {
    sink.put(point_of(i, cell, frame, type), limits_.contain(raw_of(cell)));
  }
}

void Decoder::put_pair(const std::uint8_t* odd, const std::uint8_t* even, const Frame& frame,
                       Pair pair, Sink& sink) const {
  odd += kAzimuthBytes;
  even += kAzimuthBytes;
  for (std::size_t i = 0; i < lasers_.size(); ++i, odd += kCellBytes, even += kCellBytes) {
    const std::uint8_t* last = odd;
    const std::uint8_t* strongest = even;
    // Pairs ordered by distance have the last return farther away. So of the first and the
    // strongest return, the farther one counts as the last, the nearer one as the strongest.
    if (pair == Pair::kFirstAndStrongest && raw_of(odd) < raw_of(even)) std::swap(last, strongest);
    const PairChoice choice =
        choose(limits_.contain(raw_of(last)), limits_.contain(raw_of(strongest)),
               raw_of(last) == raw_of(strongest), options_.dual_returns);
    sink.put(point_of(i, last, frame, choice.last_type), choice.last);
    sink.put(point_of(i, strongest, frame, choice.strongest_type), choice.strongest);
  }
}

std::size_t Decoder::decode_groups(const PacketPlan& plan, std::span<const PlacedGroup> groups,
                                   Point* out, std::uint16_t* columns) const {
  const Tail tail = tail_of(plan.payload, header_);
  const int blocks_per_group = kBlocksPerPacket / plan.groups;
  ReturnType single = single_type(tail.mode);
  // A first return is not selected by strength: kBoth lets later stages use it as the last or the
  // strongest.
  if (tail.first_only) single = ReturnType::kBoth;
  Sink sink{out};
  for (const PlacedGroup& placed : groups) {
    const Group& group = plan.group[static_cast<std::size_t>(placed.group)];
    const auto [cos_azimuth, sin_azimuth] = azimuth_table().cos_sin(group.azimuth_cdeg);
    const Frame frame{static_cast<float>(cos_azimuth), static_cast<float>(sin_azimuth),
                      placed.time_ns};
    const std::uint8_t* const first = block(plan.payload, placed.group * blocks_per_group);
    const Point* const before = sink.at;
    if (blocks_per_group == 1) {
      put_block(first, frame, single, sink);
    } else {
      put_pair(first, first + header_.block_bytes(), frame, tail.pair, sink);
    }
    std::fill_n(columns + (before - out), sink.at - before, placed.column);
  }
  return static_cast<std::size_t>(sink.at - out);
}

}  // namespace zloam::driver::hesai
