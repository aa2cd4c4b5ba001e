#pragma once
// Milliseconds collected over a run, and what the benchmark's Python side reads of them.

#include <map>
#include <string>
#include <vector>

namespace zloam::bench {

/// A JSON list, three digits behind the point.
std::string json_list(const std::vector<double>& samples_ms);

/// Writes {"name": value-as-JSON, ...} under the path; throws runtime::IoError.
void write_report(const std::string& path, const std::map<std::string, std::string>& values);

}  // namespace zloam::bench
