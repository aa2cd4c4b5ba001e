#pragma once
// The reply to a command that measures: ranges, intensities, several echoes of a beam.

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "driver/scip/replies.hpp"

namespace zloam::driver::scip {

/// What such a command asks for (pages 11 to 13).
struct ScanRequest {
  int first_step = 0;
  int last_step = 0;
  /// so many neighbouring steps are given as one
  int cluster = 1;
  bool intensities = false;
  bool several_echoes = false;
  /// characters of a range: 3, or 2 in the S commands
  int range_characters = 3;
  /// M and N commands: sent again and again
  bool continuous = false;
  /// of them: scans that are left out between two
  int skipped = 0;

  int steps() const { return (last_step - first_step) / cluster + 1; }
};

/// From an echo; nothing where it is no command that measures, or its numbers can't be.
std::optional<ScanRequest> scan_request(const Head& head);
/// The command that asks for scans without end.
std::string continuous_command(const ScanRequest& request);

/// One echo as the device gave it. Values below the device's least range are codes, no ranges.
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

/// Further echoes of a beam than these are left out.
inline constexpr std::uint8_t kMostEchoes = 3;

/// A reply with data: status 00, of a continuous command 99. kNoScan: the reply is none.
ScanError read_scan(const RawReply& reply, const Head& head, Scan& scan);

}  // namespace zloam::driver::scip
