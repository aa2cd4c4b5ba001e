#include "simulator/scip.hpp"

namespace zloam::simulator::scip {
namespace {

constexpr std::size_t kLineCharacters = 64;
constexpr std::uint32_t kCounterMask = 0xFFFFFF;

}  // namespace

std::string encoded(std::uint32_t value, int characters) {
  std::string text(static_cast<std::size_t>(characters), '0');
  for (auto c = text.rbegin(); c != text.rend(); ++c) {
    *c = static_cast<char>((value & 0x3F) + 0x30);
    value >>= 6;
  }
  return text;
}

char checksum(const std::string& text) {
  unsigned sum = 0;
  for (const char c : text) sum += static_cast<unsigned char>(c);
  return static_cast<char>((sum & 0x3F) + 0x30);
}

std::string reply(const std::string& echo, const std::string& status,
                  const std::vector<std::string>& lines) {
  std::string text = echo + "\n" + status + checksum(status) + "\n";
  for (const std::string& line : lines) text += line + "\n";
  return text + "\n";
}

std::string information(const std::string& text) { return text + ";" + checksum(text); }

std::vector<std::string> parameters(const Scanner& scanner) {
  const auto line = [](const char* name, const auto& value) {
    return information(std::string(name) + ":" + value);
  };
  const auto number = [&](const char* name, int value) {
    return line(name, std::to_string(value));
  };
  return {line("MODL", scanner.model),        number("DMIN", scanner.least_mm),
          number("DMAX", scanner.most_mm),    number("ARES", scanner.steps_per_turn),
          number("AMIN", scanner.first_step), number("AMAX", scanner.last_step),
          number("AFRT", scanner.front_step), number("SCAN", scanner.turns_per_minute)};
}

std::vector<std::string> scan_lines(std::uint32_t counter_ms, std::span<const Echo> echoes,
                                    bool intensities) {
  const std::string stamp = encoded(counter_ms & kCounterMask, 4);
  std::vector<std::string> lines = {stamp + checksum(stamp)};
  std::string data;
  for (const Echo& echo : echoes) {
    if (echo.further) data += '&';
    data += encoded(echo.range_mm, 3);
    if (intensities) data += encoded(echo.intensity, 3);
  }
  for (std::size_t at = 0; at < data.size(); at += kLineCharacters) {
    const std::string part = data.substr(at, kLineCharacters);
    lines.push_back(part + checksum(part));
  }
  return lines;
}

}  // namespace zloam::simulator::scip
