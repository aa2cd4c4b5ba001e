#include "sessions/merged_store.hpp"

#include <xxhash.h>

#include <algorithm>
#include <exception>
#include <optional>
#include <set>
#include <stdexcept>
#include <utility>
#include <vector>

#include "common/messages/build.hpp"
#include "common/messages/keys.hpp"
#include "mapping/io/tile_messages.hpp"
#include "store/generation.hpp"

namespace zloam::sessions {
namespace {

namespace fs = std::filesystem;

// The first term of a mapping: any that extends the map has the same or a greater one.
constexpr std::uint32_t kTerm = 1;

/// Of one cube: a larger message would not be taken.
std::size_t most_points() {
  constexpr std::size_t kHeader_bytes = std::size_t{64} << 10;
  return (key_row(Key::kMapTile).max_bytes - kHeader_bytes) /
         (sizeof(MapPoint) + sizeof(std::uint32_t));
}

/// Depends on the drives that are joined, and on their order.
std::uint64_t map_id_of(const Merged& merged) {
  std::vector<std::uint64_t> drives;
  for (const Merged::Placed& placed : merged.placed()) {
    const SavedMap& map = merged.maps[placed.session];
    drives.push_back(map.headers[placed.index].run);
    drives.push_back(static_cast<std::uint64_t>(map.submaps[placed.index].instant_ns));
  }
  return std::max<std::uint64_t>(XXH3_64bits(drives.data(), drives.size() * sizeof(drives[0])), 1);
}

/// The sessions whose cubes are in the merged map.
std::vector<std::size_t> with_cubes(const Merged& merged) {
  std::vector<std::size_t> out;
  for (std::size_t i = 0; i < merged.maps.size(); ++i) {
    if (merged.is_joined(i) && sizes_of(merged.maps[i])) out.push_back(i);
  }
  return out;
}

MapPart part_of(const Merged& merged, std::size_t session) {
  const SavedMap& map = merged.maps[session];
  MapPart part{map.tiles, map.voxels, map.places, {}};
  for (const Merged::Placed& placed : merged.placed()) {
    if (placed.session != session) continue;
    const Pose T_submap_map = map.submaps[placed.index].T_map_submap.inverse();
    part.T_world_map.push_back(normalised(placed.T_world_submap * T_submap_map));
  }
  return part;
}

/// Where the newest drive ended, in the frame of the first map. Where its last pose was not stored:
/// at its last submap.
SavedMap::LastPose last_pose_of(const Merged& merged) {
  SavedMap::LastPose newest;
  std::pair<std::int64_t, std::int64_t> newest_at{INT64_MIN, INT64_MIN};
  for (const Merged::Placed& placed : merged.placed()) {
    const SavedMap& map = merged.maps[placed.session];
    const Submap& submap = map.submaps[placed.index];
    const bool goes_on = map.last_pose && map.last_pose->instant_ns >= submap.instant_ns;
    const SavedMap::LastPose last =
        goes_on ? *map.last_pose : SavedMap::LastPose{submap.instant_ns, submap.T_map_submap};
    // Of the submaps before the pose, the correction of the last one holds.
    const std::pair at(last.instant_ns, submap.instant_ns);
    if (at < newest_at) continue;
    newest_at = at;
    const Pose T_world_map = placed.T_world_submap * submap.T_map_submap.inverse();
    newest = {last.instant_ns, normalised(T_world_map * last.T_map_base)};
  }
  return newest;
}

class StoreWriter {
 public:
  StoreWriter(const Merged& merged, const fs::path& folder)
      : merged_(merged),
        store_(folder, store::StoreLimits{}),
        keys_(merged.maps.front().robot, "any"),
        map_id_(map_id_of(merged)) {
    store::Generations generations(store_);
    generations.begin(map_id_, map_id_);
    generation_ = generations.current();
  }

  void write() {
    const SavedMap::LastPose last = last_pose_of(merged_);
    const HeaderFields header = header_at(last.instant_ns);
    MapPoseFields pose;
    pose.instant_ns = last.instant_ns;
    pose.T_map_base = last.T_map_base;
    put(keys_.of(Key::kMapOdometry), Key::kMapOdometry,
        static_cast<std::uint64_t>(std::max<std::int64_t>(last.instant_ns, 0)),
        build(header, pose));
    write_cubes(header);
    write_submaps();
    store_.sync();
  }

 private:
  HeaderFields header_at(std::int64_t instant_ns) const {
    HeaderFields header;
    header.robot = keys_.robot();
    header.sensor = merged_.maps.front().headers.front().sensor;
    header.run = header.map_id = map_id_;
    header.stamp_ns = instant_ns;
    header.frame = "map";
    header.term = kTerm;
    header.instance = "sessions";
    header.replay = std::ranges::all_of(merged_.placed(), [&](const Merged::Placed& placed) {
      return merged_.maps[placed.session].headers[placed.index].replay;
    });
    return header;
  }

  void put(const std::string& key, Key kind, std::uint64_t version, const Buffer& message) {
    if (!fits(kind, message.size())) throw std::length_error(key + " is too large for a message");
    store_.put({key,
                encoding_of(kind),
                {generation_, kTerm, version},
                {message.data(), message.data() + message.size()}});
  }

  void write_cubes(const HeaderFields& header) {
    const std::vector<std::size_t> sessions = with_cubes(merged_);
    if (sessions.empty()) return;
    MapBuilder map(sizes_of(merged_.maps[sessions.front()]).value());
    std::vector<MapPart> parts;
    for (const std::size_t i : sessions) parts.push_back(part_of(merged_, i));
    for (const MapBuilder::Half half : {MapBuilder::Half::kFirst, MapBuilder::Half::kSecond}) {
      for (const MapPart& part : parts) map.add_voxels(part, half);
    }
    map.add_points(parts, most_points());
    for (const mapping::Tile& tile : map.tiles()) {
      const mapping::TileIndex& at = tile.id.index;
      put(keys_.tile(layer_name(tile.id.layer), at.i, at.j, at.k), Key::kMapTile, tile.version,
          mapping::tile_message(header, tile));
    }
    for (const mapping::VoxelTile& cube : map.voxels()) {
      put(keys_.tile(mapping::kVoxelLayer, cube.index.i, cube.index.j, cube.index.k), Key::kMapTile,
          cube.version, mapping::voxel_message(header, cube));
    }
  }

  void write_submaps() {
    std::size_t session_before = 0;
    std::set<std::int64_t> instants;
    for (const Merged::Placed& placed : merged_.placed()) {
      const SavedMap& map = merged_.maps[placed.session];
      Submap submap = map.submaps[placed.index];
      submap.T_map_submap = placed.T_world_submap;
      if (placed.session != session_before) part(submap);
      // A key of its own, also where two robots closed a submap at the same nanosecond.
      while (!instants.insert(submap.instant_ns).second) ++submap.instant_ns;
      HeaderFields header = map.headers[placed.index];
      header.robot = keys_.robot();
      header.map_id = map_id_;
      header.term = kTerm;
      header.instance = "sessions";
      header.end_of_run = false;
      put(keys_.kept_submap(submap.instant_ns), Key::kSubmap, 0, build(header, submap));
      session_before = placed.session;
    }
  }

  /// Marks the first submap of a session: it does not follow the one before it.
  static void part(Submap& submap) {
    submap.connected = false;
    submap.before_sweep = submap.sweep;
  }

  const Merged& merged_;
  store::TileStore store_;
  Keys keys_;
  std::uint64_t map_id_;
  std::uint64_t generation_ = 0;
};

}  // namespace

std::string write_store(const Merged& merged, const fs::path& folder) {
  try {
    StoreWriter(merged, folder).write();
  } catch (const std::exception& e) {
    return "the map to localize in can't be written to " + folder.string() + ": " + e.what();
  }
  return {};
}

std::vector<std::string> lacking(const Merged& merged) {
  std::vector<std::string> said;
  for (std::size_t i = 0; i < merged.maps.size(); ++i) {
    if (!merged.is_joined(i) || sizes_of(merged.maps[i])) continue;
    said.push_back(
        merged.maps[i].folder.string() +
        ": its mapping had stored no voxels when it ended: no robot is found in this part "
        "of the merged map");
  }
  return said;
}

std::vector<std::string> notes(const Merged& merged) {
  std::vector<std::string> said;
  const std::string& robot = merged.maps.front().robot;
  for (std::size_t i = 1; i < merged.maps.size(); ++i) {
    const SavedMap& map = merged.maps[i];
    if (!merged.is_joined(i) || map.robot == robot) continue;
    said.push_back(map.folder.string() + " is of robot " + map.robot +
                   ": the merged map is found by robot " + robot + " only");
  }
  return said;
}

}  // namespace zloam::sessions
