#pragma once
// Scans from a folder, in two layouts:
//  - synthetic: scans/NNNNNN.bin of 16-byte records (float x y z, u8 intensity, u8 ring, u16 time
//  in
//    2 us), stamps.txt with begin and end of each scan in seconds;
//  - KITTI raw: NNNNNN.bin of float x y z reflectance, stored ring by ring, top ring first, without
//    times: a clockwise turn of 0.1 s with its seam at the rear is assumed.

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "common/geometry/point.hpp"

namespace zloam::offline {

struct Scan {
  std::int64_t stamp_ns = 0;
  std::uint32_t period_ns = 100000000;
  std::uint16_t rings = 16;
  PointVector points;  ///< frame lidar, in time order
};

class ScanFolder {
 public:
  /// Throws std::runtime_error when the folder holds neither layout.
  explicit ScanFolder(const std::filesystem::path& folder);
  std::size_t size() const { return files_.size(); }
  Scan read(std::size_t index) const;

 private:
  bool synthetic_ = false;
  std::vector<std::filesystem::path> files_;
  std::vector<std::int64_t> begin_ns_;
  std::vector<std::int64_t> end_ns_;
};

}  // namespace zloam::offline
