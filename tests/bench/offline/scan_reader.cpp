#include "scan_reader.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <fstream>
#include <numbers>
#include <stdexcept>

namespace zloam::offline {
namespace {

namespace fs = std::filesystem;

std::vector<char> bytes_of(const fs::path& file) {
  std::ifstream in(file, std::ios::binary);
  std::vector<char> bytes((std::istreambuf_iterator<char>(in)), std::istreambuf_iterator<char>());
  return bytes;
}

std::vector<fs::path> scans_in(const fs::path& folder) {
  std::vector<fs::path> files;
  if (fs::is_directory(folder)) {
    for (const auto& entry : fs::directory_iterator(folder)) {
      if (entry.path().extension() == ".bin") {
        files.push_back(entry.path());
      }
    }
  }
  std::sort(files.begin(), files.end());
  return files;
}

PointVector synthetic_points(const std::vector<char>& bytes) {
  struct Record {
    float x, y, z;
    std::uint8_t intensity, ring;
    std::uint16_t time_2us;
  };
  static_assert(sizeof(Record) == 16);
  PointVector points;
  for (std::size_t i = 0; i + sizeof(Record) <= bytes.size(); i += sizeof(Record)) {
    Record r;
    std::memcpy(&r, bytes.data() + i, sizeof r);
    points.push_back(
        {r.x, r.y, r.z, float(r.intensity), r.time_2us * 2000U, r.ring, ReturnType::kStrongest, 0});
  }
  return points;
}

PointVector kitti_points(const std::vector<char>& bytes, std::uint32_t period_ns,
                         std::uint16_t rings) {
  PointVector points;
  int ring = rings - 1;
  double last_turn = 0.0;
  for (std::size_t i = 0; i + 16 <= bytes.size(); i += 16) {
    float v[4];
    std::memcpy(v, bytes.data() + i, sizeof v);
    if (v[0] == 0.0F && v[1] == 0.0F && v[2] == 0.0F) {
      continue;
    }
    const double azimuth = std::atan2(v[1], v[0]);
    const double turn = azimuth < 0.0 ? azimuth + 2.0 * std::numbers::pi : azimuth;
    if (turn < last_turn - std::numbers::pi && ring > 0) {
      --ring;
    }
    last_turn = turn;
    const double fraction = (std::numbers::pi - azimuth) / (2.0 * std::numbers::pi);
    points.push_back({v[0], v[1], v[2], v[3] * 255.0F,
                      static_cast<std::uint32_t>(fraction * period_ns),
                      static_cast<std::uint16_t>(ring), ReturnType::kStrongest, 0});
  }
  std::stable_sort(points.begin(), points.end(),
                   [](const Point& a, const Point& b) { return a.time_ns < b.time_ns; });
  return points;
}

}  // namespace

ScanFolder::ScanFolder(const fs::path& folder) {
  std::ifstream stamps(folder / "stamps.txt");
  synthetic_ = stamps.is_open();
  files_ = scans_in(synthetic_ ? folder / "scans" : folder);
  if (files_.empty()) {
    throw std::runtime_error("no scans in " + folder.string());
  }
  double begin = 0.0;
  double end = 0.0;
  while (synthetic_ && stamps >> begin >> end) {
    begin_ns_.push_back(std::llround(begin * 1e9));
    end_ns_.push_back(std::llround(end * 1e9));
  }
  if (synthetic_ && begin_ns_.size() < files_.size()) {
    throw std::runtime_error("stamps.txt is shorter than the scans of " + folder.string());
  }
}

Scan ScanFolder::read(std::size_t index) const {
  Scan scan;
  const std::vector<char> bytes = bytes_of(files_.at(index));
  if (synthetic_) {
    scan.stamp_ns = begin_ns_[index];
    scan.period_ns = static_cast<std::uint32_t>(end_ns_[index] - begin_ns_[index]);
    scan.points = synthetic_points(bytes);
  } else {
    scan.stamp_ns = static_cast<std::int64_t>(index) * scan.period_ns;
    scan.rings = 64;
    scan.points = kitti_points(bytes, scan.period_ns, scan.rings);
  }
  return scan;
}

}  // namespace zloam::offline
