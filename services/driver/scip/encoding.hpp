#pragma once
// How SCIP writes numbers and guards lines. Source: Hokuyo, "Communication Protocol Specification
// for SCIP2.0 Standard", C-42-03320B, pages 6 to 9.

#include <cstdint>
#include <optional>
#include <string_view>

namespace zloam::driver::scip {

/// Characters 0x30 to 0x6F of 6 bits each, most significant first, at most five of them; nothing
/// where one is another character.
std::optional<std::uint32_t> decode(std::string_view characters);

/// Of a line without its own checksum and without its end.
char checksum(std::string_view text);

/// The text before the last character, if that is its checksum.
std::optional<std::string_view> checked(std::string_view line);
/// The text of a line "TEXT;X", as VV, PP and II have them: X is the checksum of TEXT; of some
/// devices that of "TEXT;".
std::optional<std::string_view> checked_information(std::string_view line);

}  // namespace zloam::driver::scip
