#include "mapping/map_writer.hpp"

#include <bit>
#include <cstring>

#include "common/geometry/atomic_file.hpp"

namespace zloam::mapping {
namespace {

static_assert(std::endian::native == std::endian::little, "PCD's binary data is little-endian");
constexpr std::size_t kRecordBytes = sizeof(MapPoint) + 1;

}  // namespace

std::string pcd_bytes(std::span<const LayeredPoint> points) {
  const std::string count = std::to_string(points.size());
  std::string bytes =
      "# .PCD v0.7 - Point Cloud Data file format\n"
      "VERSION 0.7\n"
      "FIELDS x y z intensity layer\n"
      "SIZE 4 4 4 4 1\n"
      "TYPE F F F F U\n"
      "COUNT 1 1 1 1 1\n"
      "WIDTH " +
      count +
      "\n"
      "HEIGHT 1\n"
      "VIEWPOINT 0 0 0 1 0 0 0\n"
      "POINTS " +
      count +
      "\n"
      "DATA binary\n";
  std::size_t at = bytes.size();
  bytes.resize(at + kRecordBytes * points.size());
  for (const LayeredPoint& p : points) {
    std::memcpy(bytes.data() + at, &p.point, sizeof(MapPoint));
    bytes[at + sizeof(MapPoint)] = static_cast<char>(p.layer);
    at += kRecordBytes;
  }
  return bytes;
}

std::string write_map(const std::string& path, std::span<const LayeredPoint> points) {
  return write_file_atomically(path, pcd_bytes(points));
}

}  // namespace zloam::mapping
