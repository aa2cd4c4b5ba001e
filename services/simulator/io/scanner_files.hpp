#pragma once
// Writes the files of a simulated scanner and its motor: a session of SCIP replies, and the angles.

#include <cstdint>
#include <string>

#include "simulator/scanner.hpp"

namespace zloam::simulator {

struct ScannerFiles {
  /// records of big-endian seconds, microseconds and length, and the bytes; empty: none
  std::string session;
  /// CSV with t_ns and angle_rad; empty: none
  std::string angles;
  bool intensities = true;
};

/// Delay from a line's last step until it is received: minimum, and maximum addition to it.
inline constexpr std::int64_t kLineDelayNs = 2'000'000;
inline constexpr std::int64_t kLineJitterNs = 1'000'000;

/// Writes the files; `progress` shows the progress on stderr. Throws std::runtime_error if a file
/// cannot be written.
void write_scanner_files(const Scanner& scanner, std::int64_t epoch_ns, double duration_s,
                         int threads, bool progress, const ScannerFiles& files);

}  // namespace zloam::simulator
