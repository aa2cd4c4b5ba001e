#pragma once
// The joined maps as a map of one run: the tile store's files, in which a robot can be localized,
// and which can be extended, exported and merged again like those of a run.
//
// It has a map_id of its own, which depends on the drives in it, and the name of the first map's
// robot. The last pose, at which a robot is searched for first, is that of the newest drive.

#include <filesystem>
#include <string>
#include <vector>

#include "sessions/merged_files.hpp"

namespace zloam::sessions {

/// Empty, or a sentence that says what failed.
std::string write_store(const Merged& merged, const std::filesystem::path& folder);

/// Which joined maps have no part in the merged one, each a sentence.
std::vector<std::string> lacking(const Merged& merged);
/// What a robot that uses the map has to know, each a sentence.
std::vector<std::string> notes(const Merged& merged);

}  // namespace zloam::sessions
