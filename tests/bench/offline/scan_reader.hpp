#pragma once
// Sweeps for the offline chain, read and decoded as the driver does it:
//  - a capture (.pcap) or a file of bare payloads (.bin);
//  - a folder of the synthetic layout (it has a stamps.txt);
//  - a folder in KITTI's layout, with times after ScanTiming;
//  - a drive to simulate (.yaml, tests/bench/search), where the simulator is built too.

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
  /// all points hold for one instant, the end of the sweep
  bool deskewed = false;
  std::uint16_t slices = 1;
  PointVector points;  ///< frame lidar, in time order
};

struct ReadOptions {
  /// of KITTI's layout
  driver::ScanTiming timing{driver::TimeModel::kClockwise, 0.1, 180.0};
  /// added to each point's elevation, degrees
  double elevation_offset_deg = 0.0;
  /// added to each range, m
  double range_offset_m = 0.0;
  /// of a scanner's session: lines of so much time are one sweep
  double sweep_s = 0.1;
  /// added to its lines' stamps
  double stamp_offset_us = 0.0;
};

class ScanReader {
 public:
  /// Throws driver::SourceError or std::runtime_error when nothing can be read there.
  ScanReader(const std::filesystem::path& path, const ReadOptions& options);
  /// The next sweep; false at the end. Incomplete sweeps come too, as in a replay.
  bool next(Scan& scan);
  /// truth.tum and motion.txt of a simulated drive; of a recording nothing.
  void write_truth(const std::filesystem::path& folder) const;

 private:
  ReadOptions options_;
  std::unique_ptr<driver::SweepSource> source_;
};

}  // namespace zloam::offline
