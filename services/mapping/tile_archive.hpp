#pragma once
// Tiles that left the window: in memory up to a number of points, then in one file.

#include <map>
#include <optional>
#include <string>
#include <vector>

#include "common/geometry/unnamed_file.hpp"
#include "mapping/layer_map.hpp"

namespace zloam::mapping {

class TileArchive {
 public:
  /// max_points: kept in memory; spill_directory empty: all stay in memory.
  TileArchive(std::uint64_t max_points, std::string spill_directory);

  struct Entry {
    std::uint64_t version = 0;
    std::vector<CountedPoint> points;
  };
  /// Replaces the tile's entry. If the file can't be written, the tile stays in memory: nothing is
  /// lost, and spill_failed() reports it.
  void put(const TileId& id, Entry entry);
  /// Without points if the file can't be read: unread_points() counts them.
  std::optional<Entry> get(const TileId& id) const;
  /// A tile whose points can't be read stays in the archive.
  std::optional<Entry> take(const TileId& id);
  std::uint64_t version(const TileId& id) const;
  std::vector<TileId> tiles() const;
  /// Including points that were lost with the file.
  std::size_t point_count() const { return total_points_ + lost_points_; }
  bool spill_failed() const { return file_ && file_->failed(); }
  /// Points that could not be read from the file, each counted once.
  std::uint64_t unread_points() const { return unread_points_; }

 private:
  struct Place {
    std::uint64_t version = 0;
    std::size_t count = 0;
    bool in_file = false;
    std::int64_t offset = 0;
    /// the file could not be read
    mutable bool is_unread = false;
    std::vector<CountedPoint> points;
  };
  bool write(Place& place);
  void drop(const TileId& id);

  std::uint64_t max_points_;
  std::optional<UnnamedFile> file_;
  std::size_t memory_points_ = 0;
  std::size_t total_points_ = 0;
  std::size_t lost_points_ = 0;
  std::map<TileId, Place> places_;
  mutable std::uint64_t unread_points_ = 0;
};

}  // namespace zloam::mapping
