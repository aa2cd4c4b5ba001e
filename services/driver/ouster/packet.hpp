#pragma once
// Headers of data and IMU packets, little endian.

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <optional>
#include <span>

#include "driver/ouster/metadata.hpp"

namespace zloam::driver::ouster {

template <class T>
T read_as(const std::uint8_t* at) {
  T value;
  std::memcpy(&value, at, sizeof value);
  return value;
}

/// Reads a number of `bytes` bytes.
inline std::uint64_t read_bytes(const std::uint8_t* at, std::size_t bytes) {
  std::uint64_t value = 0;
  for (std::size_t i = 0; i < bytes; ++i) value |= std::uint64_t{at[i]} << (8 * i);
  return value;
}

/// From a configurable packet's header; the legacy profile has none.
struct PacketHeader {
  std::uint64_t serial;
  std::uint32_t initialization_id;
};

inline PacketHeader header_of(const std::uint8_t* packet, bool fusa) {
  return fusa ? PacketHeader{read_bytes(packet + 11, 5),
                             static_cast<std::uint32_t>(read_bytes(packet + 1, 3))}
              : PacketHeader{read_bytes(packet + 7, 5),
                             static_cast<std::uint32_t>(read_bytes(packet + 4, 3))};
}

struct ColumnHeader {
  std::uint64_t time_ns;
  int number;
  bool valid;
};

/// Offsets of the columns in a data packet.
struct PacketLayout {
  explicit PacketLayout(const Metadata& metadata);

  const std::uint8_t* column(const std::uint8_t* packet, int index) const {
    return packet + header_bytes + static_cast<std::size_t>(index) * column_bytes;
  }
  const std::uint8_t* pixels(const std::uint8_t* column) const {
    return column + column_header_bytes;
  }
  ColumnHeader header(const std::uint8_t* column) const {
    constexpr std::size_t kNumberAt = 8;
    return {read_as<std::uint64_t>(column), read_as<std::uint16_t>(column + kNumberAt),
            (column[status_at] & 1) != 0};
  }

  std::size_t packet_bytes;
  std::size_t header_bytes;
  std::size_t column_bytes;
  std::size_t column_header_bytes;
  std::size_t status_at;
  int columns;
  int columns_per_frame;
  double column_ns;
};

/// Time and number of a packet's first column, computed from its first valid one.
struct PacketStamp {
  std::uint64_t time_ns;
  int first_column;
};

/// Whether a column is consistent with the packet's stamp: numbers go up by one, at the rotor's
/// pace. index: its place in the packet.
bool follows(const ColumnHeader& column, int index, const PacketStamp& stamp,
             const PacketLayout& layout);

/// Nothing if no column is valid.
std::optional<PacketStamp> stamp_of(const std::uint8_t* packet, const PacketLayout& layout);

/// The sensor's time into its hour.
inline std::uint32_t toh_us(std::uint64_t time_ns) {
  constexpr std::uint64_t kHourUs = 3'600'000'000;
  return static_cast<std::uint32_t>(time_ns / 1000 % kHourUs);
}

/// Whether a packet looks like this maker's, by the common parts of all its formats: 16 columns of
/// whole words, with consecutive numbers.
bool looks_like_data(std::span<const std::uint8_t> payload);

}  // namespace zloam::driver::ouster
