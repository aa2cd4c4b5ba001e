#include "store/key_expression.hpp"

namespace zloam::store {
namespace {

constexpr std::size_t kNone = std::string_view::npos;

std::string_view head(std::string_view text) { return text.substr(0, text.find('/')); }
bool last(std::string_view text) { return text.find('/') == kNone; }
std::string_view tail(std::string_view text) { return text.substr(text.find('/') + 1); }

}  // namespace

bool covers(std::string_view expression, std::string_view key) {
  if (head(expression) == "**") {
    if (last(expression)) return true;
    for (std::string_view rest = key;; rest = tail(rest)) {
      if (covers(tail(expression), rest)) return true;
      if (last(rest)) return false;
    }
  }
  if (head(expression) != "*" && head(expression) != head(key)) return false;
  if (last(expression) != last(key)) return last(key) && tail(expression) == "**";
  return last(key) || covers(tail(expression), tail(key));
}

}  // namespace zloam::store
