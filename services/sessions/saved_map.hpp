#pragma once
// The map that a run has left in its tile store (services/store): its submaps and its cubes.

#include <cstdint>
#include <filesystem>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "common/geometry/submap.hpp"
#include "common/messages/header.hpp"
#include "sessions/merged_map.hpp"

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
  /// drive by drive, and in the order of their instants, without moving points
  std::vector<Submap> submaps;
  /// parallel to submaps, without the trace
  std::vector<HeaderFields> headers;
  /// as mapping left them; empty: it had stored none when it ended
  std::vector<mapping::Tile> tiles;
  std::vector<mapping::VoxelTile> voxels;
  /// by the submaps with their moving points
  SeenPlaces places;
  /// where the robot was last; nothing: not stored
  struct LastPose {
    std::int64_t instant_ns = 0;
    Pose T_map_base = Pose::Identity();
  };
  std::optional<LastPose> last_pose;
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

/// Of its first cubes; nothing: it has none.
std::optional<MapSizes> sizes_of(const SavedMap& map);

/// A drive that is in both, although the maps may differ; nothing: there is none.
std::optional<std::uint64_t> common_run(const SavedMap& a, const SavedMap& b);

}  // namespace zloam::sessions
