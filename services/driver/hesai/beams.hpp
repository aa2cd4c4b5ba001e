#pragma once
// Direction and firing time of each laser of a PandarXT, and its own angles from the unit's file.

#include <cstdint>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

namespace zloam::driver::hesai {

/// A laser relative to its block. In the packet's order: from the top down.
struct Beam {
  double elevation_deg;
  /// clockwise, added to the block's azimuth
  double azimuth_offset_deg;
};

/// Nominal beams (manual, appendix I): even steps from 15 degrees down. lasers: 16 or 32.
std::vector<Beam> designed_beams(int lasers);

/// Of the first laser, after the time of its block's command; each further one fires laser_step_ns
/// later. The manual of 2021 has 3.28 + 0.28 us, the maker's later drivers have these: 2.4 us less.
inline constexpr std::int64_t kFirstFiringNs = 5'632 + 368;
/// 1.512 us for 32 lasers; 16 lasers use every second of these times.
std::int64_t laser_step_ns(int lasers);

/// Whether its first line has three fields with commas.
bool looks_like_angle_corrections(std::string_view text);

/// The angle correction file of a unit: a header line, then "laser,elevation,azimuth", in degrees.
/// The text says what is wrong with the file.
std::variant<std::vector<Beam>, std::string> parse_angle_corrections(std::string_view text);

}  // namespace zloam::driver::hesai
