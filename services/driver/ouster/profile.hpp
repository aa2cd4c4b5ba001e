#pragma once
// Offsets of the fields in a packet of each profile (Ouster, Firmware User Manual, "Sensor Data":
// LEGACY and the configurable profiles).

#include <array>
#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>

namespace zloam::driver::ouster {

/// Bits of a little-endian word.
struct Bits {
  std::uint8_t at = 0;
  std::uint32_t mask = 0;
  /// of distances that are stored in units of 8 mm
  std::uint8_t shift = 0;
};

struct ReturnFields {
  Bits range_mm;
  std::uint8_t reflectivity_at = 0;
};

/// One pixel of a column: a laser's measurement.
struct Profile {
  std::string_view name;
  std::uint8_t pixel_bytes;
  std::uint8_t returns;
  std::array<ReturnFields, 2> fields;
};

/// Nothing when unknown.
const Profile* profile_by_name(std::string_view name);

/// "LEGACY, RNG15_RFL8_NIR8, ...": for messages.
std::string known_profiles();

/// Bytes around the pixels.
struct Framing {
  std::size_t packet_header;
  std::size_t column_header;
  std::size_t column_footer;
  std::size_t packet_footer;
};

inline constexpr Framing kLegacyFraming{0, 16, 4, 0};
inline constexpr Framing kConfigurableFraming{32, 12, 0, 32};
inline constexpr std::string_view kLegacy = "LEGACY";

}  // namespace zloam::driver::ouster
