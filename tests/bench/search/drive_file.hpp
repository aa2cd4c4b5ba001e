#pragma once
// Reads drives from YAML files, as `python -m tests.bench.search` generates them.

#include <string>

#include "motion.hpp"

namespace zloam::search {

/// Throws std::invalid_argument, naming the file and the key, if anything is unknown, missing or of
/// the wrong type.
DriveConfig read_drive(const std::string& path);

}  // namespace zloam::search
