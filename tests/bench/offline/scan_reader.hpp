#pragma once
// Sweeps for the offline chain, read and decoded in the same way as by the driver:
//  - a capture (.pcap) or a file of bare payloads (.bin);
//  - a folder of the synthetic layout (it has a stamps.txt);
//  - a folder in KITTI's layout, with times after ScanTiming;
//  - a drive to simulate (.yaml, tests/bench/search), if the simulator is built.

#include <cstdint>
#include <filesystem>
#include <memory>

#include "common/geometry/point.hpp"
#include "driver/io/sweep_source.hpp"

namespace zloam::offline {

struct Scan {
  std::int64_t stamp_ns = 0;
  std::uint32_t period_ns = 100000000;
  std::uint16_t rings = 16;
  /// true if the points are already deskewed to the end of the sweep
  bool deskewed = false;
  std::uint16_t slices = 1;
  PointVector points;  ///< frame lidar, in time order
};

struct ReadOptions {
  /// times of the points in KITTI's layout
  driver::ScanTiming timing{driver::TimeModel::kClockwise, 0.1, 180.0};
  /// added to each point's elevation, degrees
  double elevation_offset_deg = 0.0;
  /// added to each range, m
  double range_offset_m = 0.0;
  /// scanner's session: duration of the lines that form one sweep
  double sweep_s = 0.1;
  /// scanner's session: added to the stamps of its lines
  double stamp_offset_us = 0.0;
};

class ScanReader {
 public:
  /// Throws driver::SourceError or std::runtime_error if the path cannot be read.
  ScanReader(const std::filesystem::path& path, const ReadOptions& options);
  /// Reads the next sweep; false at the end. As in a replay, incomplete sweeps are included.
  bool next(Scan& scan);
  /// Writes truth.tum and motion.txt of a simulated drive; writes nothing for a recording.
  void write_truth(const std::filesystem::path& folder) const;

 private:
  ReadOptions options_;
  std::unique_ptr<driver::SweepSource> source_;
};

}  // namespace zloam::offline
