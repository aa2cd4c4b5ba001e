#pragma once
// Writes the times collected over a run as the report that the benchmark's Python side reads.

#include <map>
#include <string>
#include <vector>

namespace zloam::bench {

/// A JSON list with three decimals.
std::string json_list(const std::vector<double>& samples_ms);

/// Writes {"name": value-as-JSON, ...} under the path; throws runtime::IoError.
void write_report(const std::string& path, const std::map<std::string, std::string>& values);

}  // namespace zloam::bench
