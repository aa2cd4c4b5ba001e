#pragma once
// Sentences of a satellite receiver (NMEA 0183) that sensors forward, and a check of the sensor's
// clock with them.

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

namespace zloam::driver {

/// State of the pulse-per-second input; values of the message's enumeration.
enum class Pps : std::uint8_t { kAbsent = 0, kSynchronising = 1, kLocked = 2, kError = 3 };

/// A sensor's report on its receiver.
struct PositionPacket {
  std::uint32_t toh_us = 0;
  Pps pps = Pps::kAbsent;
  /// without padding and line end; empty when there is no receiver
  std::string nmea;
};

struct NmeaFix {
  /// ns since the Unix epoch; 0 without a date
  std::int64_t utc_ns = 0;
  double latitude_deg = 0.0;
  double longitude_deg = 0.0;
  /// reported by the receiver (A)
  bool valid = false;
};

/// A $..RMC sentence. Nothing for other sentences, a wrong checksum, or fields that are no numbers.
std::optional<NmeaFix> parse_rmc(std::string_view sentence);

/// Whether a sensor's time of the hour is that of its receiver's sentence to 2 s (a sentence is of
/// the second before). True when the sentence has no date.
bool agrees_with_utc(std::uint32_t toh_us, std::int64_t utc_ns);

}  // namespace zloam::driver
