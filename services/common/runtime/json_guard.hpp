#pragma once
// What is looked at before a text that a stranger may have sent is given to any parser.

#include <cstddef>
#include <string>
#include <string_view>

namespace zloam::runtime {

inline constexpr std::size_t kMostText_bytes = std::size_t{64} << 10;
inline constexpr int kDeepestText = 8;

/// Why the text is not parsed: more than kMostText_bytes, or brackets more than kDeepestText deep
/// (a parser that recurses ends the process on 80 000 of them). Empty: it may be. Brackets count
/// within quotes too, so that no two readings of a quote can part this scan from a parser's.
std::string json_error(std::string_view text);
/// The same of a text that is not looked at.
std::string too_large(std::size_t bytes);

}  // namespace zloam::runtime
