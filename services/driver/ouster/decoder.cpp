#include "driver/ouster/decoder.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace zloam::driver::ouster {
namespace {

ReturnMode mode_of(const Metadata& metadata) {
  if (metadata.profile->returns == 2) return ReturnMode::kDual;
  return metadata.return_order == ReturnOrder::kFarthestFirst ? ReturnMode::kLast
                                                              : ReturnMode::kStrongest;
}

/// Azimuth of each column, clockwise from the sensor's front: the direction of its frame's x axis.
std::vector<int> azimuths(const std::vector<ColumnPose>& poses) {
  std::vector<int> azimuths_cdeg;
  for (const ColumnPose& pose : poses) {
    const double azimuth_deg =
        std::atan2(-pose.rows[1][0], pose.rows[0][0]) * 180.0 / std::numbers::pi;
    const long cdeg = std::lround(100.0 * azimuth_deg);
    azimuths_cdeg.push_back(static_cast<int>((cdeg + kTurnCdeg) % kTurnCdeg));
  }
  return azimuths_cdeg;
}

}  // namespace

Decoder::Decoder(const Metadata& metadata, const DecodingOptions& options)
    : metadata_(metadata),
      poses_(column_poses(metadata)),
      azimuth_cdeg_(azimuths(poses_)),
      reader_(metadata, options),
      layout_(metadata),
      mode_(mode_of(metadata)) {
  shape_stream();
}

void Decoder::shape_stream() {
  shape_.model = metadata_.model.empty() ? "ouster" : metadata_.model;
  shape_.rings = static_cast<std::uint16_t>(metadata_.pixels_per_column);
  shape_.group_ns = layout_.column_ns;
  shape_.groups_per_ns = 1.0 / layout_.column_ns;
  shape_.columns_per_turn = metadata_.columns_per_frame;
  const std::int64_t packet_ns = std::llround(layout_.column_ns * metadata_.columns_per_packet);
  shape_.packet_period_ns = {packet_ns, packet_ns};
  shape_.most_points_per_group = {reader_.lanes, reader_.lanes};
}

void Decoder::note_once(bool& noted, std::string text) {
  if (!noted) contradictions_.push_back(std::move(text));
  noted = true;
}

Reject Decoder::check_header(std::span<const std::uint8_t> payload) {
  if (metadata_.profile->name == kLegacy) return Reject::kNone;
  const PacketHeader header = header_of(payload.data(), metadata_.fusa_header);
  if (metadata_.serial != 0 && header.serial != 0 && header.serial != metadata_.serial) {
    note_once(serial_noted_, "the packets are of the sensor with the serial number " +
                                 std::to_string(header.serial) + ", the metadata of number " +
                                 std::to_string(metadata_.serial) +
                                 ": fetch the metadata of this sensor (driver.metadata)");
    return Reject::kModelMismatch;
  }
  if (metadata_.initialization_id != 0 && header.initialization_id != metadata_.initialization_id) {
    note_once(start_noted_,
              "the sensor was started or set up again after its metadata were stored: decoded by "
              "them all the same; fetch them again if its settings were changed (driver.metadata)");
  }
  return Reject::kNone;
}

PacketTail Decoder::tail(std::span<const std::uint8_t> payload) {
  PacketTail tail;
  if (payload.size() != layout_.packet_bytes) {
    tail.reject = Reject::kForeign;
    if (looks_like_data(payload)) {
      note_once(size_noted_, "packets of " + std::to_string(payload.size()) +
                                 " bytes come, the metadata say " +
                                 std::string(metadata_.profile->name) + " with " +
                                 std::to_string(layout_.packet_bytes) +
                                 ": fetch the metadata again (driver.metadata)");
    }
    return tail;
  }
  tail.reject = check_header(payload);
  if (tail.reject != Reject::kNone) return tail;
  tail.mode = mode_;
  const auto stamp = stamp_of(payload.data(), layout_);
  if (!stamp) {
    tail.reject = Reject::kBadTime;
    return tail;
  }
  tail.toh_us = toh_us(stamp->time_ns);
  tail.first_azimuth_cdeg = azimuth_cdeg_[static_cast<std::size_t>(stamp->first_column)];
  return tail;
}

/// Time from the packet with this first column to the next one; the sensor skips packets that are
/// entirely outside its azimuth window.
std::int64_t Decoder::next_packet_ns(int first_column) const {
  const int frame = layout_.columns_per_frame;
  int ahead = layout_.columns;
  const auto sees_none = [&](int first) {
    for (int c = first; c < first + layout_.columns; ++c) {
      if (metadata_.sees(c % frame)) return false;
    }
    return true;
  };
  while (ahead < frame && sees_none(first_column + ahead)) ahead += layout_.columns;
  return std::llround(ahead * layout_.column_ns);
}

PacketPlan Decoder::plan(std::span<const std::uint8_t> payload, ReturnMode mode) {
  PacketPlan plan;
  plan.payload = payload.data();
  plan.mode = mode;
  plan.groups = layout_.columns;
  plan.advance_cdeg = static_cast<double>(kTurnCdeg) / layout_.columns_per_frame;
  plan.duration_ns = packet_period_ns(mode);
  const auto stamp = stamp_of(payload.data(), layout_);
  if (!stamp) return plan;
  plan.toh_us = toh_us(stamp->time_ns);
  // The packet's stamp is in whole microseconds; the columns' offsets contain the rest.
  const std::uint64_t base_ns = stamp->time_ns - stamp->time_ns % 1000;
  for (int c = 0; c < plan.groups; ++c) {
    const ColumnHeader header = layout_.header(layout_.column(payload.data(), c));
    const int number = (stamp->first_column + c) % layout_.columns_per_frame;
    Group& group = plan.group[static_cast<std::size_t>(c)];
    group.valid = header.valid && follows(header, c, *stamp, layout_);
    if (group.valid) {
      group.azimuth_cdeg = azimuth_cdeg_[static_cast<std::size_t>(number)];
      group.offset_ns = static_cast<std::int64_t>(header.time_ns - base_ns);
    } else if (metadata_.sees(number)) {
      ++plan.bad_blocks;
    }
  }
  plan.next_ns = next_packet_ns(stamp->first_column);
  return plan;
}

std::size_t Decoder::decode_groups(const PacketPlan& plan, std::span<const PlacedGroup> groups,
                                   Point* out, std::uint16_t* columns) const {
  std::array<MeasuredColumn, kMostGroups> measured;
  for (std::size_t i = 0; i < groups.size(); ++i) {
    const std::uint8_t* const column = layout_.column(plan.payload, groups[i].group);
    const auto number = static_cast<std::size_t>(layout_.header(column).number);
    measured[i] = {layout_.pixels(column), &poses_[number], groups[i].time_ns, groups[i].column};
  }
  return put_columns(std::span(measured).first(groups.size()), reader_, out, columns);
}

}  // namespace zloam::driver::ouster
