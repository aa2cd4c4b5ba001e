#pragma once
// A map that a run has left, as its tile store keeps it (services/store): the submaps in it.

#include <cstdint>
#include <filesystem>
#include <stdexcept>
#include <string>
#include <vector>

#include "common/geometry/submap.hpp"

namespace zloam::sessions {

/// A folder that holds no map, or none that can be used; the text names it and says what to do.
class SavedMapError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

struct SavedMap {
  std::filesystem::path folder;
  std::string robot;
  std::uint64_t run = 0;
  /// in the order of their instants, without what moved
  std::vector<Submap> submaps;
};

/// Changes nothing in the folder, which a run may have open. Throws SavedMapError.
SavedMap read_saved_map(const std::filesystem::path& folder);

}  // namespace zloam::sessions
