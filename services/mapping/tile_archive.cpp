#include "mapping/tile_archive.hpp"

#include <span>
#include <type_traits>
#include <utility>

namespace zloam::mapping {
namespace {

// One point in the file, which is read back by the same process only.
struct Stored {
  double x, y, z;
  std::uint32_t count;
  float intensity;
};
static_assert(std::is_trivially_copyable_v<Stored> && sizeof(Stored) == 32);

// Tiles begin at a block of the disk, so that no block is left when a tile leaves the file.
constexpr std::size_t kBlock = 4096 / sizeof(Stored);

std::size_t in_blocks(std::size_t points) { return (points + kBlock - 1) / kBlock * kBlock; }

}  // namespace

TileArchive::TileArchive(std::uint64_t max_points, std::string spill_directory)
    : max_points_(max_points) {
  if (!spill_directory.empty()) file_.emplace(std::move(spill_directory));
}

bool TileArchive::write(Place& place) {
  if (!file_) return false;
  std::vector<Stored> stored;
  stored.reserve(in_blocks(place.points.size()));
  for (const CountedPoint& p : place.points) {
    stored.push_back({p.mean.x(), p.mean.y(), p.mean.z(), p.count, p.intensity});
  }
  stored.resize(in_blocks(stored.size()));
  const std::optional<std::int64_t> offset = file_->append(std::as_bytes(std::span(stored)));
  place.offset = offset.value_or(0);
  return offset.has_value();
}

void TileArchive::drop(const TileId& id) {
  const auto found = places_.find(id);
  if (found == places_.end()) return;
  const Place& place = found->second;
  total_points_ -= place.count;
  if (place.in_file) {
    file_->release(place.offset,
                   static_cast<std::int64_t>(in_blocks(place.count) * sizeof(Stored)));
  } else {
    memory_points_ -= place.count;
  }
  places_.erase(found);
}

void TileArchive::put(const TileId& id, Entry entry) {
  if (const auto found = places_.find(id); found != places_.end() && found->second.is_unread) {
    lost_points_ += found->second.count;
  }
  drop(id);
  Place& place = places_[id];
  place.version = entry.version;
  place.count = entry.points.size();
  place.points = std::move(entry.points);
  total_points_ += place.count;
  memory_points_ += place.count;
  if (memory_points_ <= max_points_ || !write(place)) return;
  place.in_file = true;
  place.points = {};
  memory_points_ -= place.count;
}

std::optional<TileArchive::Entry> TileArchive::get(const TileId& id) const {
  const auto found = places_.find(id);
  if (found == places_.end()) return std::nullopt;
  const Place& place = found->second;
  if (!place.in_file) return Entry{place.version, place.points};
  Entry entry{place.version, {}};
  std::vector<Stored> stored(place.count);
  if (!file_->read(place.offset, std::as_writable_bytes(std::span(stored)))) {
    if (!std::exchange(place.is_unread, true)) unread_points_ += place.count;
    return entry;
  }
  for (const Stored& s : stored) entry.points.push_back({{s.x, s.y, s.z}, s.count, s.intensity});
  return entry;
}

std::optional<TileArchive::Entry> TileArchive::take(const TileId& id) {
  std::optional<Entry> entry = get(id);
  if (!entry || entry->points.size() < places_.at(id).count) return std::nullopt;
  drop(id);
  return entry;
}

std::uint64_t TileArchive::version(const TileId& id) const {
  const auto found = places_.find(id);
  return found == places_.end() ? 0 : found->second.version;
}

std::vector<TileId> TileArchive::tiles() const {
  std::vector<TileId> ids;
  for (const auto& [id, place] : places_) ids.push_back(id);
  return ids;
}

}  // namespace zloam::mapping
