#include "store/generation.hpp"

#include <cstring>

namespace zloam::store {
namespace {

// Record of the current map. Zenoh's keys contain no '#', so no message can have this key.
constexpr const char* kKey = "#map";
constexpr std::size_t kSize = 2 * sizeof(std::uint64_t);

}  // namespace

Generations::Generations(TileStore& store) : store_(store) {
  // Without the record, in a damaged folder, the next map is still newer than those on disk.
  number_ = store.newest_map();
  const auto found = store.get(kKey);
  if (!found || found->payload.size() != kSize) return;
  std::memcpy(&run_, found->payload.data(), sizeof run_);
  std::memcpy(&map_id_, found->payload.data() + sizeof run_, sizeof map_id_);
  number_ = found->rank.map_id;
}

bool Generations::is_current(std::uint64_t run, std::uint64_t map_id) const {
  return number_ > 0 && map_id == map_id_ && (map_id != 0 || run == run_);
}

void Generations::begin(std::uint64_t run, std::uint64_t map_id) {
  StoredMessage record{kKey, "", {number_ + 1, 0, 0}, std::vector<std::uint8_t>(kSize)};
  std::memcpy(record.payload.data(), &run, sizeof run);
  std::memcpy(record.payload.data() + sizeof run, &map_id, sizeof map_id);
  store_.put(record);
  run_ = run;
  map_id_ = map_id;
  ++number_;
}

}  // namespace zloam::store
