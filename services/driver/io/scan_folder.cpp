#include "driver/io/scan_folder.hpp"

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>

#include "driver/io/scan_list.hpp"
#include "driver/scan/plausible.hpp"

namespace zloam::driver {
namespace {

namespace fs = std::filesystem;

/// Reads a file into a reused buffer, whole items only; returns the file's size.
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

/// Counts and describes damaged scan files, for both folder layouts.
class Damage {
 public:
  /// Notes a file that is empty or ends within a point; only whole points are used.
  bool cut(const std::string& file, std::size_t size_bytes, std::size_t point_bytes) {
    if (size_bytes % point_bytes == 0 && size_bytes > 0) return false;
    ++cut_;
    note(file, size_bytes == 0 ? "is empty"
                               : "its " + std::to_string(size_bytes) +
                                     " bytes are no whole number of points of " +
                                     std::to_string(point_bytes) + ": it was cut off");
    return true;
  }
  void spoilt(const std::string& file, const std::string& why) {
    ++spoilt_;
    note(file, why + ": it is left out");
  }
  void add_to(NamedCounts& counts) const {
    counts.emplace_back("scans_cut", cut_);
    counts.emplace_back("scans_spoilt", spoilt_);
  }
  std::vector<std::string> remarks_after(std::vector<std::string> all) const {
    all.insert(all.end(), remarks_.begin(), remarks_.end());
    return all;
  }

 private:
  // Only the first few are named individually.
  static constexpr std::size_t kNamed = 10;

  void note(const std::string& file, const std::string& what) {
    if (remarks_.size() < kNamed) {
      remarks_.push_back(file + ": " + what);
    } else if (remarks_.size() == kNamed) {
      remarks_.emplace_back("further scans are not whole");
    }
  }

  std::uint64_t cut_ = 0;
  std::uint64_t spoilt_ = 0;
  std::vector<std::string> remarks_;
};

std::string as_five_floats(std::size_t size_bytes) {
  return size_bytes % 20 == 0 ? " (its size fits 5 floats a point as well)" : "";
}

/// One time per file, missing scans included: times_ns holds those of the files present, those of
/// missing scans are interpolated.
std::vector<std::int64_t> times_with_gaps(const ScanList& list,
                                          const std::vector<std::int64_t>& times_ns) {
  std::vector<std::int64_t> found_ns;
  std::size_t next = 0;
  std::int64_t missing = 0;
  for (const std::string& file : list.files) {
    if (file.empty()) {
      ++missing;
      continue;
    }
    const std::int64_t time_ns = times_ns[next++];
    const std::int64_t before_ns = found_ns.empty() ? time_ns : found_ns.back();
    for (std::int64_t i = 1; i <= missing; ++i) {
      found_ns.push_back(before_ns + (time_ns - before_ns) * i / (missing + 1));
    }
    missing = 0;
    found_ns.push_back(time_ns);
  }
  return found_ns;
}

/// Assigns the times of a file to scans: it holds one time per scan, or one per scan number.
std::vector<std::int64_t> times_of(const ScanList& list, const std::vector<std::int64_t>& times_ns,
                                   const std::string& path) {
  const auto there = static_cast<std::size_t>(std::count_if(
      list.files.begin(), list.files.end(), [](const std::string& f) { return !f.empty(); }));
  if (times_ns.size() == there) return times_with_gaps(list, times_ns);
  const bool by_number =
      !list.numbers.empty() && list.first_number + list.numbers.back() < times_ns.size();
  if (!by_number) {
    throw SourceError(path + ": " + std::to_string(times_ns.size()) + " times for " +
                      std::to_string(there) + " scans: which is of which cannot be told");
  }
  std::vector<std::int64_t> found_ns;
  for (const std::uint64_t n : list.numbers) found_ns.push_back(times_ns[list.first_number + n]);
  return found_ns;
}

class KittiFolder : public ScanFolder {
 public:
  KittiFolder(const std::string& path, const ScanTiming& timing) : timing_(timing) {
    const fs::path root(path);
    const bool nested = fs::is_directory(root / "velodyne");
    list_ = list_scans((nested ? root / "velodyne" : root).string(), timing.period_s);
    if (timing.model == TimeModel::kNone) {
      throw SourceError(path +
                        ": these scans have no point times; set driver.time_model to clockwise or "
                        "counter_clockwise, or to deskewed if the points hold for one instant");
    }
    for (const std::string& file : list_.files) {
      if (!file.empty()) files_.push_back(file);
    }
    set_times(root);
    refuse_implausible();
  }

  bool next(DecodedSweep& sweep) override {
    if (index_ == list_.files.size()) return false;
    const std::string& file = list_.files[index_];
    xyzi_.clear();
    bool whole = !file.empty() && !damage_.cut(file, read_whole(file, xyzi_), kPointBytes);
    xyzi_.resize(xyzi_.size() / 4 * 4);
    KittiDiagnostics diagnostics;
    sweep = kitti_sweep(xyzi_, timing_, times_ns_[index_], &diagnostics);
    if (diagnostics.rings_found > kMostRings) {
      damage_.spoilt(file, std::to_string(diagnostics.rings_found) + " rings");
      sweep = kitti_sweep({}, timing_, times_ns_[index_]);
      whole = false;
    }
    sweep.complete = sweep.complete && whole;
    zero_range_ += diagnostics.dropped_zero_range;
    not_finite_ += diagnostics.dropped_not_finite;
    if (diagnostics.rings_found > 64) ++odd_rings_;
    ++index_;
    return true;
  }

  const std::vector<std::string>& files() const override { return files_; }

  NamedCounts counts() const override {
    NamedCounts counts = {{"scans", index_},
                          {"files_hidden", list_.hidden},
                          {"points_zero_range", zero_range_},
                          {"points_not_finite", not_finite_},
                          {"scans_with_more_than_64_rings", odd_rings_}};
    damage_.add_to(counts);
    return counts;
  }

  std::vector<std::string> remarks() const override { return damage_.remarks_after(list_.remarks); }

 private:
  static constexpr std::size_t kPointBytes = 16;

  void set_times(const fs::path& root) {
    for (const fs::path& place : {root / "times.txt", root.parent_path() / "times.txt"}) {
      if (!times_ns_.empty() || !fs::is_regular_file(place)) continue;
      times_ns_ = times_of(list_, read_times(place.string(), 1, timing_.period_s), place.string());
      files_.push_back(place.string());
    }
    if (!times_ns_.empty()) return;
    if (!list_.time_remark.empty()) list_.remarks.push_back(list_.time_remark);
    times_ns_ = list_.times_ns;
    for (std::size_t i = times_ns_.size(); i < list_.files.size(); ++i) {
      const auto number = static_cast<double>(list_.numbers.empty() ? i : list_.numbers[i]);
      times_ns_.push_back(std::llround(1e9 * timing_.period_s * number));
    }
  }

  /// Checks scans up to the first with enough returns, and lets it decide for the whole folder.
  void refuse_implausible() {
    std::size_t returns = 0;
    for (const std::string& file : list_.files) {
      if (file.empty()) continue;
      const std::size_t size_bytes = read_whole(file, xyzi_);
      xyzi_.resize(xyzi_.size() / 4 * 4);
      if (const std::string why = implausible(xyzi_); !why.empty()) {
        throw SourceError(file + ": " + why + as_five_floats(size_bytes));
      }
      returns = kitti_sweep(xyzi_, timing_, 0).points.size();
      if (returns >= kJudgedReturns) return;
      any_return_ = any_return_ || returns > 0;
    }
    if (!any_return_) throw SourceError(files_.front() + " and all others: not one return in them");
  }

  ScanTiming timing_;
  ScanList list_;
  std::vector<std::string> files_;
  std::vector<float> xyzi_;
  std::vector<std::int64_t> times_ns_;
  Damage damage_;
  bool any_return_ = false;
  std::size_t index_ = 0;
  std::uint64_t zero_range_ = 0;
  std::uint64_t not_finite_ = 0;
  std::uint64_t odd_rings_ = 0;
};

class SynthFolder : public ScanFolder {
 public:
  explicit SynthFolder(const std::string& path) {
    const fs::path root(path);
    list_ = list_scans((root / "scans").string(), kPeriodS);
    for (const std::string& file : list_.files) {
      if (!file.empty()) files_.push_back(file);
    }
    const std::string stamps = (root / "stamps.txt").string();
    set_times(read_times(stamps, 2, kPeriodS), stamps);
    files_.push_back(stamps);
  }

  bool next(DecodedSweep& sweep) override {
    if (index_ == list_.files.size()) return false;
    sweep = scan(index_);
    if (const std::string why = implausible(sweep); !why.empty()) {
      if (!judged_) throw SourceError(list_.files[index_] + ": " + why);
      damage_.spoilt(list_.files[index_], why);
      sweep = *synth_sweep({}, begins_ns_[index_], ends_ns_[index_]);
      sweep.complete = false;
    }
    judged_ = judged_ || sweep.points.size() >= kJudgedReturns;
    ++index_;
    return true;
  }

  const std::vector<std::string>& files() const override { return files_; }
  NamedCounts counts() const override {
    NamedCounts counts = {{"scans", index_}, {"files_hidden", list_.hidden}};
    damage_.add_to(counts);
    return counts;
  }
  std::vector<std::string> remarks() const override { return damage_.remarks_after(list_.remarks); }

 private:
  static constexpr std::size_t kRecordBytes = 16;
  // Period of the sensor that this layout was made for.
  static constexpr double kPeriodS = 0.1;

  void set_times(const std::vector<std::int64_t>& stamps_ns, const std::string& path) {
    std::vector<std::int64_t> begins_ns, ends_ns;
    for (std::size_t i = 0; i + 1 < stamps_ns.size(); i += 2) {
      begins_ns.push_back(stamps_ns[i]);
      ends_ns.push_back(stamps_ns[i + 1]);
    }
    begins_ns_ = times_of(list_, begins_ns, path);
    ends_ns_ = times_of(list_, ends_ns, path);
  }

  DecodedSweep scan(std::size_t index) {
    const std::string& file = list_.files[index];
    records_.clear();
    const bool whole =
        !file.empty() && !damage_.cut(file, read_whole(file, records_), kRecordBytes);
    records_.resize(records_.size() / kRecordBytes * kRecordBytes);
    DecodedSweep sweep = *synth_sweep(records_, begins_ns_[index], ends_ns_[index]);
    sweep.complete = sweep.complete && whole;
    return sweep;
  }

  ScanList list_;
  std::vector<std::string> files_;
  std::vector<std::byte> records_;
  std::vector<std::int64_t> begins_ns_;
  std::vector<std::int64_t> ends_ns_;
  Damage damage_;
  bool judged_ = false;
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
