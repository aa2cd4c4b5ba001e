#pragma once
// Integers in the byte order of most sensors.

#include <cstdint>

namespace zloam::driver {

inline std::uint16_t read_u16(const std::uint8_t* at) {
  return static_cast<std::uint16_t>(at[0] | (at[1] << 8));
}

inline std::uint32_t read_u32(const std::uint8_t* at) {
  return read_u16(at) | (static_cast<std::uint32_t>(read_u16(at + 2)) << 16);
}

}  // namespace zloam::driver
