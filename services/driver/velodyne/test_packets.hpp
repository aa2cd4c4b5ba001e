#pragma once
// Packets made byte by byte, for tests.

#include <array>
#include <cstdint>
#include <vector>

#include "driver/velodyne/decoder.hpp"

namespace zloam::driver::velodyne::test {

using Payload = std::array<std::uint8_t, kDataPacketBytes>;

struct CellBytes {
  int block;
  int channel;
  std::array<std::uint8_t, 3> bytes;
};

inline Payload make_payload(const std::vector<int>& azimuths_cdeg,
                            const std::vector<CellBytes>& cells,
                            const std::array<std::uint8_t, 6>& tail) {
  Payload payload{};
  for (std::size_t k = 0; k < kBlocksPerPacket; ++k) {
    payload[100 * k] = 0xFF;
    payload[100 * k + 1] = 0xEE;
    payload[100 * k + 2] = static_cast<std::uint8_t>(azimuths_cdeg[k] & 0xFF);
    payload[100 * k + 3] = static_cast<std::uint8_t>(azimuths_cdeg[k] >> 8);
  }
  for (const CellBytes& cell : cells) {
    const auto at = static_cast<std::size_t>(100 * cell.block + 4 + 3 * cell.channel);
    for (std::size_t i = 0; i < 3; ++i) payload[at + i] = cell.bytes[i];
  }
  for (std::size_t i = 0; i < 6; ++i) payload[1200 + i] = tail[i];
  return payload;
}

inline std::vector<int> azimuth_steps(int first_cdeg, int step_cdeg, bool dual = false) {
  std::vector<int> azimuths;
  for (int k = 0; k < kBlocksPerPacket; ++k) {
    azimuths.push_back((first_cdeg + step_cdeg * (dual ? k / 2 : k)) % kTurnCdeg);
  }
  return azimuths;
}

/// CRC-32 (IEEE), to check that the input is the published one.
inline std::uint32_t crc32(const Payload& payload) {
  std::uint32_t crc = 0xFFFFFFFFU;
  for (const std::uint8_t byte : payload) {
    crc ^= byte;
    for (int bit = 0; bit < 8; ++bit) crc = (crc >> 1) ^ ((crc & 1U) != 0 ? 0xEDB88320U : 0U);
  }
  return ~crc;
}

/// A rotating sensor that sees a wall at one distance in every cell: produces its packets.
class TurningSensor {
 public:
  std::uint8_t product_id = 0x22;
  std::uint8_t mode = 0x37;
  double group_us = 110.592;
  double rpm = 600.0;
  double azimuth_deg = 0.0;
  double time_us = 1'000'000.0;
  /// firings outside [first, last] degrees are dropped, as by the sensor's own setting
  double view_first_deg = 0.0;
  double view_last_deg = 360.0;
  std::uint16_t raw_distance = 5000;

  Payload next() {
    std::vector<int> azimuths;
    double first_us = -1.0;
    while (azimuths.size() < kBlocksPerPacket) {
      const bool inside = azimuth_deg >= view_first_deg && azimuth_deg < view_last_deg;
      if (inside) {
        if (first_us < 0.0) first_us = time_us;
        const int cdeg = static_cast<int>(azimuth_deg * 100.0) % kTurnCdeg;
        azimuths.push_back(cdeg);
        if (mode == 0x39) azimuths.push_back(cdeg);
      }
      time_us += group_us;
      azimuth_deg += 6.0 * rpm * group_us * 1e-6;
      if (azimuth_deg >= 360.0) azimuth_deg -= 360.0;
    }
    return with_cells(
        azimuths, static_cast<std::uint32_t>(static_cast<std::int64_t>(first_us) % 3'600'000'000));
  }

 private:
  Payload with_cells(const std::vector<int>& azimuths, std::uint32_t toh_us) const {
    std::vector<CellBytes> cells;
    for (int k = 0; k < kBlocksPerPacket; ++k) {
      for (int c = 0; c < 32; ++c) {
        cells.push_back({k,
                         c,
                         {static_cast<std::uint8_t>(raw_distance & 0xFF),
                          static_cast<std::uint8_t>(raw_distance >> 8), 50}});
      }
    }
    std::array<std::uint8_t, 6> tail{};
    for (unsigned i = 0; i < 4; ++i) tail[i] = static_cast<std::uint8_t>(toh_us >> (8 * i));
    tail[4] = mode;
    tail[5] = product_id;
    return make_payload(azimuths, cells, tail);
  }
};

}  // namespace zloam::driver::velodyne::test
