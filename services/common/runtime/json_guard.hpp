#pragma once
// Checks on a text of unknown origin before any parser reads it.

#include <cstddef>
#include <string>
#include <string_view>

namespace zloam::runtime {

inline constexpr std::size_t kMostText_bytes = std::size_t{64} << 10;
inline constexpr int kDeepestText = 8;

/// Why the text is not parsed: longer than kMostText_bytes, or brackets nested deeper than
/// kDeepestText (a recursive parser ends the process on 80 000 of them). Empty: it may be parsed.
/// Brackets within quotes count too, so that this scan can't disagree with a parser about quotes.
std::string json_error(std::string_view text);
/// The error for a text that is too large.
std::string too_large(std::size_t bytes);

}  // namespace zloam::runtime
