#pragma once
// Which files of a folder are scans, in which order, and of which time.

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace zloam::driver {

struct ScanList {
  /// in their order; an empty name: the scan of this number is missing
  std::vector<std::string> files;
  /// begin of each, where the names tell it
  std::vector<std::int64_t> times_ns;
  /// number in each one's name less the first one's, where the names are numbers of scans
  std::vector<std::uint64_t> numbers;
  /// the first one's number
  std::uint64_t first_number = 0;
  /// files that begin with a dot: no scans, whatever their extension
  std::uint64_t hidden = 0;
  /// sentences about what is not as it should be
  std::vector<std::string> remarks;
};

/// *.bin of the folder by the numbers in their names. Throws SourceError.
ScanList list_scans(const std::string& folder, double period_s);

/// Seconds, `columns` of them a line, in ns. Throws SourceError for what is no number, for times
/// that do not ascend, and where they are no seconds.
std::vector<std::int64_t> read_times(const std::string& path, std::size_t columns, double period_s);

}  // namespace zloam::driver
