#include "common/runtime/json_guard.hpp"

#include <algorithm>

namespace zloam::runtime {

std::string too_large(std::size_t bytes) {
  return std::to_string(bytes) + " bytes are more than the " + std::to_string(kMostText_bytes) +
         " that are read";
}

std::string json_error(std::string_view text) {
  if (text.size() > kMostText_bytes) return too_large(text.size());
  int depth = 0;
  for (const char c : text) {
    if (c == '[' || c == '{') ++depth;
    if (c == ']' || c == '}') depth = std::max(depth - 1, 0);
    if (depth > kDeepestText) {
      return "brackets more than " + std::to_string(kDeepestText) + " deep are not read";
    }
  }
  return {};
}

}  // namespace zloam::runtime
