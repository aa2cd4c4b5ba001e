#pragma once
// One line per event to standard error, as text or JSON. Any thread.

#include <initializer_list>
#include <string>
#include <string_view>
#include <type_traits>

namespace zloam::runtime {

enum class Level { kDebug, kInfo, kWarning, kError };

/// A value beside the message, e.g. {"sweep", 17}.
struct LogField {
  template <class T>
  requires std::is_arithmetic_v<T> LogField(std::string_view n, T v)
      : name(n), value(std::to_string(v)), quoted(false) {}
  LogField(std::string_view n, std::string_view v) : name(n), value(v), quoted(true) {}
  std::string_view name;
  std::string value;
  bool quoted;
};

void log(Level level, std::string_view message, std::initializer_list<LogField> fields = {});
inline void log_info(std::string_view m, std::initializer_list<LogField> f = {}) {
  log(Level::kInfo, m, f);
}
inline void log_warning(std::string_view m, std::initializer_list<LogField> f = {}) {
  log(Level::kWarning, m, f);
}
inline void log_error(std::string_view m, std::initializer_list<LogField> f = {}) {
  log(Level::kError, m, f);
}

}  // namespace zloam::runtime
