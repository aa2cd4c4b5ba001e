#include "mapping/tile_archive.hpp"

#include <cstdio>
#include <cstdlib>
#include <type_traits>
#include <utility>

namespace zloam::mapping {
namespace {

// What one point takes in the file; read back by the same process only.
struct Stored {
  double x, y, z;
  std::uint32_t count;
  float intensity;
};
static_assert(std::is_trivially_copyable_v<Stored> && sizeof(Stored) == 32);

}  // namespace

TileArchive::TileArchive(std::uint64_t max_points, std::string spill_directory)
    : max_points_(max_points), spill_directory_(std::move(spill_directory)) {}

TileArchive::~TileArchive() { close(); }

TileArchive::TileArchive(TileArchive&& other) noexcept
    : max_points_(other.max_points_),
      spill_directory_(std::move(other.spill_directory_)),
      file_(std::exchange(other.file_, nullptr)),
      spill_failed_(other.spill_failed_),
      memory_points_(std::exchange(other.memory_points_, 0)),
      total_points_(std::exchange(other.total_points_, 0)),
      places_(std::move(other.places_)) {}

TileArchive& TileArchive::operator=(TileArchive&& other) noexcept {
  if (this == &other) return *this;
  close();
  max_points_ = other.max_points_;
  spill_directory_ = std::move(other.spill_directory_);
  file_ = std::exchange(other.file_, nullptr);
  spill_failed_ = other.spill_failed_;
  memory_points_ = std::exchange(other.memory_points_, 0);
  total_points_ = std::exchange(other.total_points_, 0);
  places_ = std::move(other.places_);
  return *this;
}

void TileArchive::close() {
  if (file_ != nullptr) std::fclose(file_);
  file_ = nullptr;
}

// The file has no name from the start: it goes with the process, however that ends.
bool TileArchive::write(Place& place) {
  if (spill_failed_) return false;
  if (file_ == nullptr) {
    std::string name = spill_directory_ + "/tiles.XXXXXX";
    const int descriptor = mkstemp(name.data());
    if (descriptor >= 0) {
      std::remove(name.c_str());
      file_ = fdopen(descriptor, "w+b");
    }
  }
  spill_failed_ = file_ == nullptr || std::fseek(file_, 0, SEEK_END) != 0;
  if (spill_failed_) return false;
  place.offset = std::ftell(file_);
  for (const CountedPoint& p : place.points) {
    const Stored stored{p.mean.x(), p.mean.y(), p.mean.z(), p.count, p.intensity};
    spill_failed_ |= std::fwrite(&stored, sizeof stored, 1, file_) != 1;
  }
  spill_failed_ |= std::fflush(file_) != 0;
  return !spill_failed_;
}

void TileArchive::put(const TileId& id, Entry entry) {
  take(id);
  Place& place = places_[id];
  place.version = entry.version;
  place.count = entry.points.size();
  place.points = std::move(entry.points);
  total_points_ += place.count;
  memory_points_ += place.count;
  if (spill_directory_.empty() || memory_points_ <= max_points_ || !write(place)) return;
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
  if (std::fseek(file_, place.offset, SEEK_SET) != 0 ||
      std::fread(stored.data(), sizeof(Stored), stored.size(), file_) != stored.size()) {
    return entry;
  }
  for (const Stored& s : stored) entry.points.push_back({{s.x, s.y, s.z}, s.count, s.intensity});
  return entry;
}

std::optional<TileArchive::Entry> TileArchive::take(const TileId& id) {
  std::optional<Entry> entry = get(id);
  if (!entry) return entry;
  const Place& place = places_.at(id);
  total_points_ -= place.count;
  if (!place.in_file) memory_points_ -= place.count;
  places_.erase(id);
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
