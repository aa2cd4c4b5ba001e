#include "sessions/saved_map.hpp"

#include <algorithm>

#include "common/messages/convert.hpp"
#include "common/messages/keys.hpp"
#include "common/messages/kinds.hpp"
#include "common/messages/verify.hpp"
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

}  // namespace

SavedMap read_saved_map(const fs::path& folder) {
  if (!holds_a_store(folder)) {
    throw SavedMapError(folder.string() +
                        ": holds no map; name the folder of a run with MAP=folder or --map folder");
  }
  SavedMap out;
  out.folder = folder;
  const store::TileStore store(folder, store::StoreLimits{}, store::Access::kRead);
  out.unread_bytes = store.recovery().cut_bytes;
  out.unread_files = store.recovery().ignored_segments + store.recovery().missing_files;
  out.missing = store.recovery().missing;
  out.unread_records = store.unreadable();
  out.damaged = store.recovery().damaged || out.unread_records > 0;
  std::int64_t begun_ns = 0;
  for (const std::string& key : store.keys()) {
    if (!Keys::is_kept_submap(key)) continue;
    const auto message = store.get(key);
    if (!message || !verify<msg::Submap>(message->payload, message->encoding).ok()) {
      throw SavedMapError(folder.string() + ": " + key + " can't be read: the file is damaged");
    }
    const auto& submap = message_of<msg::Submap>(message->payload);
    out.robot = submap.header()->robot()->str();
    const bool is_first = out.submaps.empty() || submap.instant_ns() < begun_ns;
    if (is_first) begun_ns = submap.instant_ns();
    if (is_first) out.run = submap.header()->run();
    out.submaps.push_back(standing(submap_of(submap)));
  }
  if (out.submaps.empty()) {
    throw SavedMapError(
        folder.string() +
        ": the map has no submaps: its run ended before the first 10 m, or its mapping was "
        "another method's (--method)");
  }
  std::ranges::sort(out.submaps, {}, &Submap::instant_ns);
  return out;
}

}  // namespace zloam::sessions
