#pragma once
// Packets of PandarXT sensors made byte by byte from the manual's tables, for tests.

#include <cmath>
#include <cstdint>
#include <vector>

namespace zloam::driver::hesai::test {

using Bytes = std::vector<std::uint8_t>;

inline void put_u16(Bytes& bytes, std::size_t at, unsigned value) {
  bytes[at] = static_cast<std::uint8_t>(value);
  bytes[at + 1] = static_cast<std::uint8_t>(value >> 8);
}

inline void put_u32(Bytes& bytes, std::size_t at, std::uint32_t value) {
  put_u16(bytes, at, value & 0xFFFF);
  put_u16(bytes, at + 2, value >> 16);
}

/// Offset of a cell; block and laser count from 0.
inline std::size_t cell_at(int lasers, int block, int laser) {
  const int at = 12 + block * (2 + 4 * lasers) + 2 + 4 * laser;
  return static_cast<std::size_t>(at);
}

/// A packet without returns. time_us: since the top of the hour, of the last block's command.
inline Bytes packet(int lasers, std::uint8_t mode, std::uint32_t time_us, double first_azimuth_deg,
                    double block_step_deg) {
  const auto tail = static_cast<std::size_t>(12 + 8 * (2 + 4 * lasers));
  Bytes bytes(tail + 28, 0);
  const Bytes header = {0xEE, 0xFF, 6, 1, 0, 0, static_cast<std::uint8_t>(lasers), 8, 0, 4, 2, 1};
  std::copy(header.begin(), header.end(), bytes.begin());
  for (int block = 0; block < 8; ++block) {
    const int firing = mode >= 0x39 ? block / 2 : block;
    const long cdeg = std::lround(100.0 * (first_azimuth_deg + block_step_deg * firing));
    put_u16(bytes, cell_at(lasers, block, 0) - 2, static_cast<unsigned>(cdeg % 36000));
  }
  bytes[tail + 10] = mode;
  put_u16(bytes, tail + 11, 600);
  // 26 November 2026, 13 o'clock.
  const Bytes date = {126,
                      11,
                      26,
                      13,
                      static_cast<std::uint8_t>(time_us / 60'000'000),
                      static_cast<std::uint8_t>(time_us / 1'000'000 % 60)};
  std::copy(date.begin(), date.end(), bytes.begin() + static_cast<std::ptrdiff_t>(tail) + 13);
  put_u32(bytes, tail + 19, time_us % 1'000'000);
  bytes[tail + 23] = 0x42;
  return bytes;
}

inline void set_cell(Bytes& bytes, int lasers, int block, int laser, unsigned raw,
                     std::uint8_t reflectivity) {
  const std::size_t at = cell_at(lasers, block, laser);
  put_u16(bytes, at, raw);
  bytes[at + 2] = reflectivity;
}

}  // namespace zloam::driver::hesai::test
