#include "common/runtime/log.hpp"

#include <spdlog/sinks/stdout_sinks.h>
#include <spdlog/spdlog.h>

#include <nlohmann/json.hpp>

#include "common/runtime/log_setup.hpp"

namespace zloam::runtime {
namespace {

struct State {
  std::shared_ptr<spdlog::logger> logger;
  bool json = false;
  std::string stage = "zloam";
};

// Created on first use and never destroyed, because threads of the transport may log until the
// process ends.
State& state() {
  static State* const kState = [] {
    auto* s = new State;
    s->logger = std::make_shared<spdlog::logger>("zloam",
                                                 std::make_shared<spdlog::sinks::stderr_sink_mt>());
    s->logger->set_pattern("%Y-%m-%dT%H:%M:%S.%fZ %-7l %v", spdlog::pattern_time_type::utc);
    return s;
  }();
  return *kState;
}

spdlog::level::level_enum level_of(Level level) {
  switch (level) {
    case Level::kDebug:
      return spdlog::level::debug;
    case Level::kInfo:
      return spdlog::level::info;
    case Level::kWarning:
      return spdlog::level::warn;
    case Level::kError:
      return spdlog::level::err;
  }
  return spdlog::level::info;
}

std::string json_text(std::string_view text) {
  // Bytes from the outside need not be UTF-8.
  return nlohmann::json(text).dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
}

std::string text_line(std::string_view message, std::initializer_list<LogField> fields) {
  std::string line = state().stage + ": " + std::string(message);
  for (const LogField& f : fields) {
    line += " " + std::string(f.name) + "=" + (f.quoted ? json_text(f.value) : f.value);
  }
  return line;
}

/// The JSON object's fields after time and level, which the logger's pattern writes.
std::string json_line(std::string_view message, std::initializer_list<LogField> fields) {
  std::string line = "\"stage\":" + json_text(state().stage) + ",\"message\":" + json_text(message);
  for (const LogField& f : fields) {
    line += "," + json_text(f.name) + ":" + (f.quoted ? json_text(f.value) : f.value);
  }
  return line;
}

}  // namespace

void setup_log(const std::string& stage, const std::string& level, bool json) {
  State& s = state();
  s.stage = stage;
  s.json = json;
  if (json) {
    s.logger->set_pattern(R"({"time":"%Y-%m-%dT%H:%M:%S.%fZ","level":"%l",%v})",
                          spdlog::pattern_time_type::utc);
  }
  s.logger->set_level(spdlog::level::from_str(level));
}

void log(Level level, std::string_view message, std::initializer_list<LogField> fields) {
  State& s = state();
  const auto wanted = level_of(level);
  if (!s.logger->should_log(wanted)) return;
  s.logger->log(wanted, "{}", s.json ? json_line(message, fields) : text_line(message, fields));
  if (level == Level::kError) s.logger->flush();
}

}  // namespace zloam::runtime
