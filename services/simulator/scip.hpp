#pragma once
// Encodes the replies of a Hokuyo scanner (SCIP 2.0). Source: Hokuyo, "Communication Protocol
// Specification for SCIP2.0 Standard", C-42-03320B.

#include <cstdint>
#include <span>
#include <string>
#include <vector>

namespace zloam::simulator::scip {

/// The value as characters of 6 bits each, most significant first (page 7).
std::string encoded(std::uint32_t value, int characters);
/// Checksum of a line without its line end (page 9).
char checksum(const std::string& text);
/// A complete reply: the echoed command, the status with its checksum, the lines unchanged, and an
/// empty line.
std::string reply(const std::string& echo, const std::string& status,
                  const std::vector<std::string>& lines = {});
/// A line "TEXT;X" of the replies to VV, PP and II; the checksum X does not include the semicolon.
std::string information(const std::string& text);

/// The parameters of a scanner that the command PP reports.
struct Scanner {
  std::string model = "UTM-30LX-EW";
  int least_mm = 23;
  int most_mm = 60000;
  int steps_per_turn = 1440;
  int first_step = 0;
  int last_step = 1080;
  int front_step = 540;
  int turns_per_minute = 2400;

  std::int64_t turn_ns() const { return 60'000'000'000 / turns_per_minute; }
  std::int64_t step_ns(int step) const { return turn_ns() * step / steps_per_turn; }
};
std::vector<std::string> parameters(const Scanner& scanner);

/// One measurement of a step. `further`: another echo of the same beam as the previous one.
struct Echo {
  int step = 0;
  bool further = false;
  std::uint32_t range_mm = 0;
  std::uint32_t intensity = 0;
};

/// Time stamp and data of one scan, in lines of 64 characters with their checksums (page 12).
std::vector<std::string> scan_lines(std::uint32_t counter_ms, std::span<const Echo> echoes,
                                    bool intensities);

}  // namespace zloam::simulator::scip
