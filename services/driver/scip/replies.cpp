#include "driver/scip/replies.hpp"

#include <array>
#include <charconv>
#include <numbers>
#include <stdexcept>
#include <utility>

#include "driver/scip/encoding.hpp"

namespace zloam::driver::scip {
namespace {

constexpr std::size_t kStatusLine = 1;
constexpr std::size_t kFirstLine = 2;

// Prefixes of commands with three characters; all others have two.
constexpr std::array<std::string_view, 3> kLong = {"TM", "%S", "SC"};

std::size_t command_size(std::string_view echo) {
  if (echo.starts_with("SCIP2.0")) return 7;
  for (const std::string_view begin : kLong) {
    if (echo.starts_with(begin)) return 3;
  }
  return 2;
}

struct Meaning {
  std::string_view status;
  std::string_view text;
};

constexpr std::array kGeneral = {
    Meaning{"0C", "the command is too short"},
    Meaning{"0H", "the command is too short"},
    Meaning{"0D", "the command is too long"},
    Meaning{"0E", "the device knows no such command"},
    Meaning{"0F", "not supported by this device"},
    Meaning{"0G", "the string is too long"},
    Meaning{"0L", "the device is abnormal"},
    Meaning{"0M", "the device is unstable"},
    Meaning{"10", "denied: the laser is off, or the state does not allow it"},
};
constexpr std::array kOfMeasuring = {
    Meaning{"01", "the first step is no number"},
    Meaning{"02", "the last step is no number"},
    Meaning{"03", "the cluster is no number"},
    Meaning{"04", "the last step is beyond the device's"},
    Meaning{"05", "the last step is before the first"},
    Meaning{"06", "the interval is no number"},
    Meaning{"07", "the number of scans is no number"},
};
constexpr std::array kOfAdjusting = {
    Meaning{"01", "no such mode"},
    Meaning{"02", "it is in this mode already"},
    Meaning{"03", "it was not in this mode"},
    Meaning{"04", "it is not in this mode"},
};

template <class Table>
std::string_view find_in(const Table& table, std::string_view status) {
  for (const Meaning& row : table) {
    if (row.status == status) return row.text;
  }
  return {};
}

int number(const std::map<std::string, std::string>& values, const char* name, int least,
           int most) {
  const auto found = values.find(name);
  if (found == values.end()) {
    throw std::invalid_argument(std::string("its reply to PP has no line ") + name);
  }
  const std::string& text = found->second;
  int value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc{} || end != text.data() + text.size() || value < least || value > most) {
    throw std::invalid_argument("its reply to PP says " + std::string(name) + ":" + text +
                                ", which can't be");
  }
  return value;
}

}  // namespace

std::optional<Head> head_of(const RawReply& reply) {
  if (reply.lines.size() < kFirstLine) return std::nullopt;
  const auto status = checked(reply.lines[kStatusLine]);
  if (!status || status->size() != 2) return std::nullopt;
  Head head;
  std::string_view echo = reply.lines.front();
  if (const std::size_t semicolon = echo.find(';'); semicolon != std::string_view::npos) {
    head.user = echo.substr(semicolon + 1);
    echo = echo.substr(0, semicolon);
  }
  head.command = echo.substr(0, command_size(echo));
  head.parameters = echo.substr(head.command.size());
  head.status = *status;
  return head;
}

bool is_of_scip1(const RawReply& reply) {
  return reply.lines.size() == kFirstLine && reply.lines[kStatusLine].size() == 1;
}

bool measures(std::string_view command) {
  if (command.size() != 2) return false;
  const bool several_echoes = command[0] == 'H' || command[0] == 'N';
  const bool known = several_echoes || command[0] == 'G' || command[0] == 'M';
  const std::string_view forms = several_echoes ? "DE" : "DSE";
  return known && forms.find(command[1]) != std::string_view::npos;
}

bool is_refusal(const Head& head) {
  const bool accepted = head.status == "00" || head.status == "98" || head.status == "99";
  return measures(head.command) && !accepted && !is_fault(head) && !is_unstable(head);
}

bool is_unknown(const Head& head) { return head.status == "0E" || head.status == "0F"; }

bool is_fault(const Head& head) {
  if (head.status == "0L") return true;
  int code = 0;
  const char* const end = head.status.data() + head.status.size();
  const auto [at, error] = std::from_chars(head.status.data(), end, code);
  if (error != std::errc{} || at != end) return false;
  if (head.command == "BM") return code == 1;
  return measures(head.command) && code >= 21 && code <= 97;
}

bool is_unstable(const Head& head) { return head.status == "0M"; }

std::string meaning(const Head& head) {
  std::string_view text = find_in(kGeneral, head.status);
  if (head.command == "BM" && head.status == "01") text = "the laser does not come on";
  if (head.command == "BM" && head.status == "02") text = "the laser is on already";
  if (measures(head.command) && text.empty()) text = find_in(kOfMeasuring, head.status);
  if (head.command.starts_with("TM") && text.empty()) text = find_in(kOfAdjusting, head.status);
  if (text.empty() && is_fault(head)) text = "the device has stopped measuring: a fault of its own";
  if (text.empty() && head.status == "98") text = "it measures again";
  if (text.empty()) text = "a status that the protocol does not name";
  return head.command + " was answered with status " + head.status + ": " + std::string(text);
}

std::map<std::string, std::string> values_of(const RawReply& reply, int& damaged) {
  std::map<std::string, std::string> values;
  for (std::size_t i = kFirstLine; i < reply.lines.size(); ++i) {
    const auto text = checked_information(reply.lines[i]);
    const std::size_t colon = text ? text->find(':') : std::string_view::npos;
    if (colon == std::string_view::npos) {
      ++damaged;
      continue;
    }
    values.emplace(text->substr(0, colon), text->substr(colon + 1));
  }
  return values;
}

double Parameters::azimuth_rad(int step) const {
  return 2.0 * std::numbers::pi * static_cast<double>(step - front_step) / steps_per_turn;
}

Parameters parameters_of(const std::map<std::string, std::string>& values) {
  constexpr int kMostMm = 1 << 18;
  constexpr int kMostSteps = 9999;
  // With nine of ten scans skipped, the time of one line must fit into the 32-bit nanoseconds of a
  // sweep. The slowest scanners turn at 600.
  constexpr int kLeastTurnsPerMinute = 160;
  Parameters p;
  if (const auto model = values.find("MODL"); model != values.end()) p.model = model->second;
  p.least_mm = static_cast<std::uint32_t>(number(values, "DMIN", 0, kMostMm));
  p.most_mm = static_cast<std::uint32_t>(number(values, "DMAX", 1, kMostMm));
  p.steps_per_turn = number(values, "ARES", 4, kMostSteps);
  p.first_step = number(values, "AMIN", 0, kMostSteps);
  p.last_step = number(values, "AMAX", p.first_step, kMostSteps);
  p.front_step = number(values, "AFRT", 0, kMostSteps);
  p.turns_per_minute = number(values, "SCAN", kLeastTurnsPerMinute, 60'000);
  if (p.last_step >= p.first_step + p.steps_per_turn) {
    throw std::invalid_argument("its reply to PP has more steps than a turn");
  }
  return p;
}

std::optional<std::uint32_t> counter_of(const RawReply& reply) {
  if (reply.lines.size() <= kFirstLine) return std::nullopt;
  const auto text = checked(reply.lines[kFirstLine]);
  return text ? decode_counter_ms(*text) : std::nullopt;
}

}  // namespace zloam::driver::scip
