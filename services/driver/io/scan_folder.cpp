#include "driver/io/scan_folder.hpp"

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>

namespace zloam::driver {
namespace {

namespace fs = std::filesystem;

std::vector<std::string> scan_files(const fs::path& path) {
  if (!fs::exists(path)) throw SourceError(path.string() + ": no such directory");
  if (!fs::is_directory(path)) throw SourceError(path.string() + ": is not a directory");
  std::vector<std::string> files;
  for (const auto& entry : fs::directory_iterator(path)) {
    if (entry.is_regular_file() && entry.path().extension() == ".bin") {
      files.push_back(entry.path().string());
    }
  }
  if (files.empty()) throw SourceError(path.string() + ": holds no scans (*.bin)");
  std::sort(files.begin(), files.end());
  return files;
}

/// Into memory that is used again; returns the file's size, of which whole items are read.
template <typename Item>
std::size_t read_whole(const std::string& path, std::vector<Item>& items) {
  std::ifstream file(path, std::ios::binary | std::ios::ate);
  if (!file) throw SourceError(path + ": " + std::strerror(errno));
  const auto size_bytes = static_cast<std::size_t>(file.tellg());
  items.resize(size_bytes / sizeof(Item));
  file.seekg(0);
  file.read(reinterpret_cast<char*>(items.data()),
            static_cast<std::streamsize>(items.size() * sizeof(Item)));
  if (!file) throw SourceError(path + ": cannot be read to its end");
  return size_bytes;
}

/// Seconds by line, columns of them a line, in ns.
std::vector<std::int64_t> read_stamps(const std::string& path, std::size_t needed) {
  std::ifstream file(path);
  if (!file) throw SourceError(path + ": " + std::strerror(errno));
  std::vector<std::int64_t> stamps_ns;
  double seconds = 0.0;
  while (file >> seconds) stamps_ns.push_back(std::llround(seconds * 1e9));
  if (stamps_ns.size() < needed) {
    throw SourceError(path + ": " + std::to_string(stamps_ns.size()) + " times, " +
                      std::to_string(needed) + " are needed for the scans there are");
  }
  return stamps_ns;
}

class KittiFolder : public ScanFolder {
 public:
  KittiFolder(const std::string& path, const ScanTiming& timing) : timing_(timing) {
    const fs::path root(path);
    const bool nested = fs::is_directory(root / "velodyne");
    files_ = scan_files(nested ? root / "velodyne" : root);
    scans_ = files_.size();
    if (timing.model == TimeModel::kNone) {
      throw SourceError(path +
                        ": these scans have no point times; set driver.time_model to clockwise or "
                        "counter_clockwise, or to deskewed if the points hold for one instant");
    }
    for (const fs::path& place : {root / "times.txt", root.parent_path() / "times.txt"}) {
      if (!stamps_ns_.empty() || !fs::is_regular_file(place)) continue;
      stamps_ns_ = read_stamps(place.string(), scans_);
      files_.push_back(place.string());
    }
  }

  bool next(DecodedSweep& sweep) override {
    if (index_ == scans_) return false;
    const std::string& file = files_[index_];
    const std::size_t size_bytes = read_whole(file, xyzi_);
    if (size_bytes % 16 != 0) {
      throw SourceError(file + ": " + std::to_string(size_bytes) +
                        " bytes are no whole number of points of 16");
    }
    const std::int64_t start_ns =
        stamps_ns_.empty() ? std::llround(1e9 * timing_.period_s * static_cast<double>(index_))
                           : stamps_ns_[index_];
    KittiDiagnostics diagnostics;
    sweep = kitti_sweep(xyzi_, timing_, start_ns, &diagnostics);
    zero_range_ += diagnostics.dropped_zero_range;
    not_finite_ += diagnostics.dropped_not_finite;
    if (diagnostics.rings_found > 64) ++odd_rings_;
    ++index_;
    return true;
  }

  const std::vector<std::string>& files() const override { return files_; }

  NamedCounts counts() const override {
    return {{"scans", index_},
            {"points_zero_range", zero_range_},
            {"points_not_finite", not_finite_},
            {"scans_with_more_than_64_rings", odd_rings_}};
  }

 private:
  ScanTiming timing_;
  std::vector<std::string> files_;
  std::vector<float> xyzi_;
  std::size_t scans_ = 0;
  std::vector<std::int64_t> stamps_ns_;
  std::size_t index_ = 0;
  std::uint64_t zero_range_ = 0;
  std::uint64_t not_finite_ = 0;
  std::uint64_t odd_rings_ = 0;
};

class SynthFolder : public ScanFolder {
 public:
  explicit SynthFolder(const std::string& path) {
    const fs::path root(path);
    files_ = scan_files(root / "scans");
    scans_ = files_.size();
    files_.push_back((root / "stamps.txt").string());
    stamps_ns_ = read_stamps(files_.back(), 2 * scans_);
  }

  bool next(DecodedSweep& sweep) override {
    if (index_ == scans_) return false;
    const std::string& file = files_[index_];
    read_whole(file, records_);
    auto scan = synth_sweep(records_, stamps_ns_[2 * index_], stamps_ns_[2 * index_ + 1]);
    if (!scan) {
      throw SourceError(file + ": " + std::to_string(records_.size()) +
                        " bytes are no whole number of points of 16");
    }
    sweep = std::move(*scan);
    ++index_;
    return true;
  }

  const std::vector<std::string>& files() const override { return files_; }
  NamedCounts counts() const override { return {{"scans", index_}}; }

 private:
  std::vector<std::string> files_;
  std::vector<std::byte> records_;
  std::size_t scans_ = 0;
  std::vector<std::int64_t> stamps_ns_;
  std::size_t index_ = 0;
};

}  // namespace

std::unique_ptr<ScanFolder> open_kitti(const std::string& path, const ScanTiming& timing) {
  return std::make_unique<KittiFolder>(path, timing);
}

std::unique_ptr<ScanFolder> open_synth(const std::string& path) {
  return std::make_unique<SynthFolder>(path);
}

}  // namespace zloam::driver
