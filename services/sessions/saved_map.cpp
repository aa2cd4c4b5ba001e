#include "sessions/saved_map.hpp"

#include <algorithm>
#include <map>
#include <tuple>
#include <utility>

#include "common/messages/convert.hpp"
#include "common/messages/key_match.hpp"
#include "common/messages/keys.hpp"
#include "common/messages/kinds.hpp"
#include "common/messages/verify.hpp"
#include "mapping/io/tile_messages.hpp"
#include "sessions/standing.hpp"
#include "store/tile_store.hpp"

namespace zloam::sessions {
namespace {

namespace fs = std::filesystem;

bool holds_a_store(const fs::path& folder) {
  if (!fs::is_directory(folder)) return false;
  return std::ranges::any_of(fs::directory_iterator(folder), [](const fs::directory_entry& e) {
    return e.path().extension() == ".log" || e.path().extension() == ".base";
  });
}

struct Stored {
  Submap submap;
  HeaderFields header;
};

/// First and last instant of each run.
using Drives = std::map<std::uint64_t, std::pair<std::int64_t, std::int64_t>>;

void note(Drives& drives, std::uint64_t run, std::int64_t instant_ns) {
  const auto [found, is_new] = drives.try_emplace(run, instant_ns, instant_ns);
  auto& [first_ns, last_ns] = found->second;
  first_ns = std::min(first_ns, instant_ns);
  last_ns = std::max(last_ns, instant_ns);
}

Drives drives_of(const SavedMap& map) {
  Drives drives;
  for (std::size_t i = 0; i < map.submaps.size(); ++i) {
    note(drives, map.headers[i].run, map.submaps[i].instant_ns);
  }
  return drives;
}

/// Drive by drive: in a merged map two robots may have driven at the same time.
void take_in_order(std::vector<Stored> stored, SavedMap& out) {
  Drives drives;
  for (const Stored& s : stored) note(drives, s.header.run, s.submap.instant_ns);
  const auto place = [&](const Stored& s) {
    return std::tuple(drives.at(s.header.run).first, s.header.run, s.submap.instant_ns);
  };
  std::ranges::sort(stored, {}, place);
  for (Stored& s : stored) {
    const std::vector<bool> moving = moving_points(s.submap);
    out.places.add(s.submap, moving, out.submaps.size());
    out.submaps.push_back(without(s.submap, moving));
    out.headers.push_back(std::move(s.header));
  }
  out.run = out.headers.front().run;
}

SavedMapError unreadable(const fs::path& folder, const std::string& key) {
  return SavedMapError(folder.string() + ": " + key + " can't be read: the file is damaged");
}

Stored read_submap(const store::TileStore& store, const std::string& key, const fs::path& folder) {
  const auto message = store.get(key);
  if (!message || !verify<msg::Submap>(message->payload, message->encoding).ok()) {
    throw unreadable(folder, key);
  }
  const auto& submap = message_of<msg::Submap>(message->payload);
  Stored out{submap_of(submap), header_fields(*submap.header())};
  out.header.trace.clear();
  return out;
}

void read_cubes(const store::TileStore& store, const Keys& keys, SavedMap& out) {
  mapping::SavedMap cubes;
  for (const std::string& key : store.keys()) {
    if (!key_matches(keys.all_tiles(), key)) continue;
    const auto message = store.get(key);
    if (!message || !verify<msg::MapTile>(message->payload, message->encoding).ok()) {
      throw unreadable(out.folder, key);
    }
    mapping::add_tile(message_of<msg::MapTile>(message->payload), cubes);
  }
  out.tiles = std::move(cubes.tiles);
  out.voxels = std::move(cubes.voxels);
}

void note_damage(const store::TileStore& store, SavedMap& out) {
  out.unread_bytes = store.recovery().cut_bytes;
  out.unread_files = store.recovery().ignored_segments + store.recovery().missing_files;
  out.missing = store.recovery().missing;
  out.unread_records = store.unreadable();
  out.damaged = store.recovery().damaged || out.unread_records > 0;
}

std::optional<SavedMap::LastPose> read_last_pose(const store::TileStore& store, const Keys& keys) {
  const auto message = store.get(keys.of(Key::kMapOdometry));
  if (!message || !verify<msg::MapPose>(message->payload, message->encoding).ok()) return {};
  const auto& pose = message_of<msg::MapPose>(message->payload);
  return SavedMap::LastPose{pose.instant_ns(), pose_of(pose.pose_map_base())};
}

}  // namespace

SavedMap read_saved_map(const fs::path& folder) {
  if (!holds_a_store(folder)) {
    throw SavedMapError(folder.string() +
                        ": holds no map; name the folder of a run with MAP=folder or --map folder");
  }
  SavedMap out;
  out.folder = folder;
  const store::TileStore store(folder, store::StoreLimits{}, store::Access::kRead);
  note_damage(store, out);
  std::vector<Stored> stored;
  for (const std::string& key : store.keys()) {
    if (Keys::is_kept_submap(key)) stored.push_back(read_submap(store, key, folder));
  }
  if (stored.empty()) {
    throw SavedMapError(
        folder.string() +
        ": the map has no submaps: its run ended before the first 10 m, or its mapping was "
        "another method's (--method)");
  }
  out.robot = stored.back().header.robot;
  take_in_order(std::move(stored), out);
  const Keys keys(out.robot, "any");
  read_cubes(store, keys, out);
  out.last_pose = read_last_pose(store, keys);
  return out;
}

std::optional<MapSizes> sizes_of(const SavedMap& map) {
  if (map.tiles.empty() || map.voxels.empty()) return std::nullopt;
  const mapping::VoxelTile& cube = map.voxels.front();
  return MapSizes{map.tiles.front().edge_m, cube.root_voxel_m, cube.levels, cube.range_noise_m};
}

std::optional<std::uint64_t> common_run(const SavedMap& a, const SavedMap& b) {
  const Drives of_a = drives_of(a), of_b = drives_of(b);
  for (const auto& [run, times] : of_a) {
    const auto found = of_b.find(run);
    if (found == of_b.end()) continue;
    // One run may begin several maps, one after the other.
    const bool apart = times.second < found->second.first || found->second.second < times.first;
    if (!apart) return run;
  }
  return std::nullopt;
}

}  // namespace zloam::sessions
