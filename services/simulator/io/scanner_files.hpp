#pragma once
// What a simulated scanner and its motor leave behind: a session of SCIP replies, and the angles.

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

/// From a line's last step until it is received: at least, and by how much more at most.
inline constexpr std::int64_t kLineDelayNs = 2'000'000;
inline constexpr std::int64_t kLineJitterNs = 1'000'000;

/// Shows its progress on stderr if asked to. Throws std::runtime_error when a file can't be written.
void write_scanner_files(const Scanner& scanner, std::int64_t epoch_ns, double duration_s,
                         int threads, bool progress, const ScannerFiles& files);

}  // namespace zloam::simulator
