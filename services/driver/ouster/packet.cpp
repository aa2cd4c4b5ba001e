#include "driver/ouster/packet.hpp"

#include <cmath>

namespace zloam::driver::ouster {
namespace {

/// Whether there are sixteen columns, numbered consecutively or restarting at 0.
bool has_columns(std::span<const std::uint8_t> payload, const Framing& framing,
                 std::size_t pixel_bytes) {
  constexpr std::size_t kColumns = 16;
  constexpr std::size_t kLeastPixels = 16;
  constexpr std::size_t kNumberAt = 8;
  const std::size_t around = framing.packet_header + framing.packet_footer;
  if (payload.size() <= around || (payload.size() - around) % kColumns != 0) return false;
  const std::size_t column_bytes = (payload.size() - around) / kColumns;
  const std::size_t column_around = framing.column_header + framing.column_footer;
  if (column_bytes <= column_around) return false;
  if ((column_bytes - column_around) % (kLeastPixels * pixel_bytes) != 0) return false;
  const auto number = [&](std::size_t column) {
    return read_as<std::uint16_t>(payload.data() + framing.packet_header + column * column_bytes +
                                  kNumberAt);
  };
  for (std::size_t c = 1; c < kColumns; ++c) {
    if (number(c) != 0 && number(c) != number(c - 1) + 1) return false;
  }
  return number(1) != 0 || number(2) != 0;
}

}  // namespace

PacketLayout::PacketLayout(const Metadata& metadata)
    : packet_bytes(metadata.packet_bytes()),
      header_bytes(metadata.framing().packet_header),
      column_bytes(metadata.column_bytes()),
      column_header_bytes(metadata.framing().column_header),
      columns(metadata.columns_per_packet),
      columns_per_frame(metadata.columns_per_frame),
      column_ns(metadata.column_ns()) {
  constexpr std::size_t kStatusAt = 10;
  const std::size_t footer_bytes = metadata.framing().column_footer;
  status_at = footer_bytes > 0 ? column_bytes - footer_bytes : kStatusAt;
}

std::optional<PacketStamp> stamp_of(const std::uint8_t* packet, const PacketLayout& layout) {
  for (int c = 0; c < layout.columns; ++c) {
    const ColumnHeader header = layout.header(layout.column(packet, c));
    if (!header.valid || header.number >= layout.columns_per_frame) continue;
    const auto after_ns = static_cast<std::uint64_t>(std::llround(c * layout.column_ns));
    const int frame = layout.columns_per_frame;
    return PacketStamp{header.time_ns - after_ns, (header.number - c + frame) % frame};
  }
  return std::nullopt;
}

bool follows(const ColumnHeader& column, int index, const PacketStamp& stamp,
             const PacketLayout& layout) {
  // Columns are fired by the encoder's angle; the motor's speed differs from nominal by a few
  // percent.
  constexpr double kMostColumnsOff = 8.0;
  const double off_ns =
      static_cast<double>(static_cast<std::int64_t>(column.time_ns - stamp.time_ns)) -
      index * layout.column_ns;
  return column.number == (stamp.first_column + index) % layout.columns_per_frame &&
         std::abs(off_ns) < kMostColumnsOff * layout.column_ns;
}

bool looks_like_data(std::span<const std::uint8_t> payload) {
  constexpr std::size_t kWordBytes = 4;
  constexpr std::uint16_t kDataPacket = 1;
  const std::size_t legacy_pixel_bytes = profile_by_name(kLegacy)->pixel_bytes;
  if (has_columns(payload, kLegacyFraming, legacy_pixel_bytes)) return true;
  return has_columns(payload, kConfigurableFraming, kWordBytes) &&
         read_as<std::uint16_t>(payload.data()) == kDataPacket;
}

}  // namespace zloam::driver::ouster
