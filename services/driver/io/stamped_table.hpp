#pragma once
// Tables of stamped numbers: commas, semicolons or tabs between the columns, a first line of names
// in any order, comments with #.

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

namespace zloam::driver {

struct StampedRow {
  std::int64_t stamp_ns = 0;
  /// in the order of the requested columns
  std::vector<double> values;
};

/// columns: the stamp's, then those of the values; others are ignored. Throws SourceError that
/// names file, line and column.
std::vector<StampedRow> read_stamped_table(const std::string& path,
                                           const std::vector<std::string_view>& columns);

}  // namespace zloam::driver
