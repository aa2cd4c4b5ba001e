#include "driver/scip/scan.hpp"

#include <algorithm>
#include <array>
#include <charconv>
#include <cstdio>

#include "driver/scip/encoding.hpp"

namespace zloam::driver::scip {
namespace {

constexpr std::size_t kStampLine = 2;
constexpr std::size_t kIntensityCharacters = 3;
// Lengths of the parameters: SSSSEEEECC, and INN more for continuous commands.
constexpr std::size_t kSingle = 10;
constexpr std::size_t kContinuous = 13;

std::optional<int> digits(std::string_view text) {
  int value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc{} || end != text.data() + text.size() || value < 0) return std::nullopt;
  return value;
}

/// Joins the data lines, as a value may extend across two of them. False if a checksum is wrong.
bool joined(const RawReply& reply, std::string& data) {
  for (std::size_t i = kStampLine + 1; i < reply.lines.size(); ++i) {
    const auto text = checked(reply.lines[i]);
    if (!text) return false;
    data += *text;
  }
  return true;
}

}  // namespace

std::optional<ScanRequest> scan_request(const Head& head) {
  if (!measures(head.command)) return std::nullopt;
  const char kind = head.command[0];
  const char form = head.command[1];
  ScanRequest request;
  request.continuous = kind == 'M' || kind == 'N';
  request.several_echoes = kind == 'H' || kind == 'N';
  request.intensities = form == 'E';
  request.range_characters = form == 'S' ? 2 : 3;
  const std::string_view text = head.parameters;
  if (text.size() != (request.continuous ? kContinuous : kSingle)) return std::nullopt;
  const auto first = digits(text.substr(0, 4));
  const auto last = digits(text.substr(4, 4));
  const auto cluster = digits(text.substr(8, 2));
  const auto skipped = request.continuous ? digits(text.substr(10, 1)) : 0;
  if (!first || !last || !cluster || !skipped || *last < *first) return std::nullopt;
  request.first_step = *first;
  request.last_step = *last;
  request.cluster = std::max(1, *cluster);
  request.skipped = *skipped;
  return request;
}

std::string continuous_command(const ScanRequest& request) {
  std::array<char, 32> text{};
  std::snprintf(text.data(), text.size(), "%c%c%04d%04d%02d%d00",
                request.several_echoes ? 'N' : 'M', request.intensities ? 'E' : 'D',
                request.first_step, request.last_step, request.cluster, request.skipped);
  return text.data();
}

ScanError read_scan(const RawReply& reply, const Head& head, Scan& scan) {
  const auto request = scan_request(head);
  const std::string_view with_data = request && request->continuous ? "99" : "00";
  if (!request || head.status != with_data || reply.lines.size() <= kStampLine) {
    return ScanError::kNoScan;
  }
  const auto stamp = checked(reply.lines[kStampLine]);
  std::string data;
  if (!stamp || !joined(reply, data)) return ScanError::kChecksum;
  const auto counter = decode_counter_ms(*stamp);
  if (!counter) return ScanError::kCharacters;
  scan = {*request, *counter, {}, reply.received_ns};
  const auto range_size = static_cast<std::size_t>(request->range_characters);
  const std::size_t size = range_size + (request->intensities ? kIntensityCharacters : 0);
  std::string_view rest = data;
  int step = request->first_step - request->cluster;
  std::uint8_t number = 0;
  while (!rest.empty()) {
    const bool further = request->several_echoes && rest.front() == '&';
    if (further) rest.remove_prefix(1);
    if (rest.size() < size || (further && scan.echoes.empty())) return ScanError::kLength;
    const auto range = decode(rest.substr(0, range_size));
    const auto intensity =
        request->intensities ? decode(rest.substr(range_size, kIntensityCharacters)) : 0;
    if (!range || !intensity) return ScanError::kCharacters;
    rest.remove_prefix(size);
    step += further ? 0 : request->cluster;
    number = further ? static_cast<std::uint8_t>(std::min<int>(number + 1, kMostEchoes)) : 0;
    if (number < kMostEchoes) scan.echoes.push_back({step, number, *range, *intensity});
  }
  const int steps = scan.echoes.empty() ? 0 : (step - request->first_step) / request->cluster + 1;
  return steps == request->steps() ? ScanError::kNone : ScanError::kLength;
}

}  // namespace zloam::driver::scip
