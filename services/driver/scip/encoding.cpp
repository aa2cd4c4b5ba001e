#include "driver/scip/encoding.hpp"

namespace zloam::driver::scip {
namespace {

constexpr unsigned char kLeast = 0x30;
constexpr unsigned char kMost = 0x6F;
constexpr unsigned kSixBits = 0x3F;
constexpr std::size_t kMostCharacters = 5;
constexpr std::size_t kMillisecondCharacters = 4, kMicrosecondCharacters = 11;
constexpr std::uint64_t kCounterMask = 0xFFFFFF;

/// The lower 64 bits.
std::optional<std::uint64_t> decode_long(std::string_view characters) {
  std::uint64_t value = 0;
  for (const char c : characters) {
    const auto byte = static_cast<unsigned char>(c);
    if (byte < kLeast || byte > kMost) return std::nullopt;
    value = (value << 6) | static_cast<std::uint64_t>(byte - kLeast);
  }
  return value;
}

}  // namespace

std::optional<std::uint32_t> decode(std::string_view characters) {
  if (characters.empty() || characters.size() > kMostCharacters) return std::nullopt;
  const auto value = decode_long(characters);
  if (!value) return std::nullopt;
  return static_cast<std::uint32_t>(*value);
}

std::optional<std::uint32_t> decode_counter_ms(std::string_view characters) {
  if (characters.size() == kMillisecondCharacters) return decode(characters);
  if (characters.size() != kMicrosecondCharacters) return std::nullopt;
  const auto value_us = decode_long(characters);
  if (!value_us) return std::nullopt;
  return static_cast<std::uint32_t>((*value_us / 1000) & kCounterMask);
}

char checksum(std::string_view text) {
  unsigned sum = 0;
  for (const char c : text) sum += static_cast<unsigned char>(c);
  return static_cast<char>((sum & kSixBits) + kLeast);
}

std::optional<std::string_view> checked(std::string_view line) {
  if (line.empty()) return std::nullopt;
  const std::string_view text = line.substr(0, line.size() - 1);
  return checksum(text) == line.back() ? std::optional(text) : std::nullopt;
}

std::optional<std::string_view> checked_information(std::string_view line) {
  if (line.size() < 2 || line[line.size() - 2] != ';') return std::nullopt;
  const std::string_view text = line.substr(0, line.size() - 2);
  const bool whole = checksum(text) == line.back() || checked(line).has_value();
  return whole ? std::optional(text) : std::nullopt;
}

}  // namespace zloam::driver::scip
