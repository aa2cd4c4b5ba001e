#pragma once
// Which files of a folder are scans, with their order and times.

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace zloam::driver {

struct ScanList {
  /// in order; an empty name: the scan of this number is missing
  std::vector<std::string> files;
  /// begin of each, if the names contain it
  std::vector<std::int64_t> times_ns;
  /// number in each name minus the first one's, if the names are numbers of scans
  std::vector<std::uint64_t> numbers;
  /// the first one's number
  std::uint64_t first_number = 0;
  /// files that begin with a dot: not scans, whatever their extension
  std::uint64_t hidden = 0;
  /// sentences about problems
  std::vector<std::string> remarks;
  /// a sentence on the scans' times, where no file has them; empty: nothing to say
  std::string time_remark;
};

/// The *.bin files of the folder, by the numbers in their names. Throws SourceError.
ScanList list_scans(const std::string& folder, double period_s);

/// Reads seconds, `columns` of them per line, in ns. Throws SourceError for invalid numbers, times
/// that do not ascend, or values that are not seconds.
std::vector<std::int64_t> read_times(const std::string& path, std::size_t columns, double period_s);

}  // namespace zloam::driver
