#include "common/messages/key_match.hpp"

#include <cstddef>

namespace zloam {
namespace {

std::string_view first_chunk(std::string_view text) { return text.substr(0, text.find('/')); }

std::string_view after_chunk(std::string_view text) {
  const std::size_t slash = text.find('/');
  return slash == std::string_view::npos ? std::string_view() : text.substr(slash + 1);
}

}  // namespace

bool key_matches(std::string_view expression, std::string_view key) {
  if (expression.empty()) return key.empty();
  const std::string_view chunk = first_chunk(expression);
  const std::string_view rest = after_chunk(expression);
  if (chunk == "**") {
    if (key_matches(rest, key)) return true;
    return !key.empty() && key_matches(expression, after_chunk(key));
  }
  if (key.empty() || (chunk != "*" && chunk != first_chunk(key))) return false;
  return key_matches(rest, after_chunk(key));
}

}  // namespace zloam
