#pragma once
// The map that a run has left in its tile store (services/store): the submaps in it.

#include <cstdint>
#include <filesystem>
#include <stdexcept>
#include <string>
#include <vector>

#include "common/geometry/submap.hpp"

namespace zloam::sessions {

/// The folder holds no map, or an unusable one; the text names it and says what to do.
class SavedMapError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

struct SavedMap {
  std::filesystem::path folder;
  std::string robot;
  /// that began the map
  std::uint64_t run = 0;
  /// in the order of their instants, without moving points
  std::vector<Submap> submaps;
  /// what of the folder's files can't be read or is not there, and later files that are useless
  /// without it: what they held is missing
  std::uint64_t unread_bytes = 0, unread_files = 0;
  /// whole records of an unknown format, as of a later version
  std::uint64_t unread_records = 0;
  /// names of files that are not there although later ones are
  std::string missing;
  /// More is missing than what a run was writing when it was killed, or is writing now.
  bool damaged = false;
};

/// Changes nothing in the folder, which a run may have open. Throws SavedMapError.
SavedMap read_saved_map(const std::filesystem::path& folder);

}  // namespace zloam::sessions
