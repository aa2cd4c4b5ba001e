#include "common/geometry/map_file.hpp"

#include <bit>
#include <cstring>
#include <string_view>
#include <utility>

#include "common/geometry/atomic_file.hpp"

namespace zloam {
namespace {

static_assert(std::endian::native == std::endian::little, "PCD's binary data is little-endian");
constexpr std::size_t kRecordBytes = sizeof(MapPoint) + 1;

std::string header(std::size_t points) {
  const std::string count = std::to_string(points);
  return "# .PCD v0.7 - Point Cloud Data file format\n"
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
}

void set_records(std::string& bytes, const std::vector<LayeredPoint>& points) {
  bytes.resize(kRecordBytes * points.size());
  std::size_t at = 0;
  for (const LayeredPoint& p : points) {
    std::memcpy(bytes.data() + at, &p.point, sizeof(MapPoint));
    bytes[at + sizeof(MapPoint)] = static_cast<char>(p.layer);
    at += kRecordBytes;
  }
}

}  // namespace

std::string write_map(const std::string& path, std::size_t count, const NextPoints& next) {
  std::string piece = header(count);
  bool is_header = true;
  std::size_t written = 0;
  const auto next_piece = [&]() -> std::string_view {
    if (!std::exchange(is_header, false)) set_records(piece, next());
    written += piece.size();
    return piece;
  };
  const auto verdict = [&]() -> std::string {
    const std::size_t points = (written - header(count).size()) / kRecordBytes;
    if (points == count) return {};
    return "cannot write " + path + ": only " + std::to_string(points) + " of " +
           std::to_string(count) + " points of the map can be read";
  };
  return write_file_atomically(path, next_piece, verdict);
}

}  // namespace zloam
