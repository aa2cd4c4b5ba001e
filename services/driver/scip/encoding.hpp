#pragma once
// How SCIP encodes numbers and protects lines. Source: Hokuyo, "Communication Protocol
// Specification for SCIP2.0 Standard", C-42-03320B, pages 6 to 9.

#include <cstdint>
#include <optional>
#include <string_view>

namespace zloam::driver::scip {

/// Decodes characters 0x30 to 0x6F of 6 bits each, most significant first, at most five; nothing if
/// one is another character.
std::optional<std::uint32_t> decode(std::string_view characters);

/// A time stamp in milliseconds, 24 bits: four characters of milliseconds, or, of newer firmware,
/// eleven of microseconds, of which the rest is dropped.
std::optional<std::uint32_t> decode_counter_ms(std::string_view characters);

/// Checksum of a line without its own checksum and end.
char checksum(std::string_view text);

/// The text before the last character, if that is its checksum.
std::optional<std::string_view> checked(std::string_view line);
/// The text of a line "TEXT;X", as in VV, PP and II: X is the checksum of TEXT; for some devices
/// that of "TEXT;".
std::optional<std::string_view> checked_information(std::string_view line);

}  // namespace zloam::driver::scip
