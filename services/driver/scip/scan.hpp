#pragma once
// The reply to a measuring command: ranges, intensities, several echoes of a beam.

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "driver/scip/replies.hpp"

namespace zloam::driver::scip {

/// Parameters of such a command (pages 11 to 13).
struct ScanRequest {
  int first_step = 0;
  int last_step = 0;
  /// number of neighbouring steps merged into one
  int cluster = 1;
  bool intensities = false;
  bool several_echoes = false;
  /// characters of a range: 3, or 2 in the S commands
  int range_characters = 3;
  /// M and N commands: scans are sent continuously
  bool continuous = false;
  /// for these: scans skipped between two
  int skipped = 0;

  int steps() const { return (last_step - first_step) / cluster + 1; }
};

/// From an echo; nothing if it is not a measuring command, or its numbers are invalid.
std::optional<ScanRequest> scan_request(const Head& head);
/// The command that requests continuous scans.
std::string continuous_command(const ScanRequest& request);

/// One echo as the device sent it. Values below the device's least range are codes, not ranges.
struct Echo {
  /// first of the cluster's steps
  int step = 0;
  std::uint8_t number = 0;
  std::uint32_t range_mm = 0;
  std::uint32_t intensity = 0;
};

struct Scan {
  ScanRequest request;
  /// the device's counter at step 0, 24 bits
  std::uint32_t counter_ms = 0;
  std::vector<Echo> echoes;
  std::int64_t received_ns = 0;
};

enum class ScanError : std::uint8_t { kNone, kNoScan, kChecksum, kCharacters, kLength };

/// Further echoes of a beam than these are dropped.
inline constexpr std::uint8_t kMostEchoes = 3;

/// Reads a reply with data: status 00, or 99 of a continuous command. kNoScan: not such a reply.
ScanError read_scan(const RawReply& reply, const Head& head, Scan& scan);

}  // namespace zloam::driver::scip
