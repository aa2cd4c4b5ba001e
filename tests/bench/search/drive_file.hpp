#pragma once
// Drives described in YAML files, as `python -m tests.bench.search` draws them.

#include <string>

#include "motion.hpp"

namespace zloam::search {

/// Throws std::invalid_argument that names the file and the key for anything unknown, missing or of
/// another type.
DriveConfig read_drive(const std::string& path);

}  // namespace zloam::search
