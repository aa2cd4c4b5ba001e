#pragma once
// Shared by the variants of cell-to-point conversion. Not for other files.

#include <cstddef>
#include <cstdint>
#include <cstring>

#include "common/geometry/lanes.hpp"
#include "driver/velodyne/block_points.hpp"

namespace zloam::driver::velodyne {

using Columns = std::uint16_t __attribute__((vector_size(2 * kChannelsPerColumn)));
inline constexpr std::size_t kFlagAndAzimuthBytes = 4;
inline constexpr std::size_t kCellBytes = 3;

inline std::size_t channel_of(int bank, int cell) {
  const int channel = bank * kCellsPerBlock + cell;
  return static_cast<std::size_t>(channel);
}

// The two halves of a point as in memory, each written at once: writing member by member takes
// twice as long.
inline constexpr std::size_t kHalf = 16;
static_assert(offsetof(Point, time_ns) == kHalf && offsetof(Point, ring) == kHalf + 4 &&
              offsetof(Point, return_type) == kHalf + 6 && sizeof(Point) == kHalf + 8);

/// The type's bits beside the ring.
inline std::uint32_t type_bits(ReturnType type) { return static_cast<std::uint32_t>(type) << 16; }

/// The second half of a point.
inline std::uint64_t rest_of(std::uint32_t time_ns, std::uint32_t ring_and_type) {
  return time_ns | static_cast<std::uint64_t>(ring_and_type) << 32;
}

/// Every cell is written, and kept only if it is a return: cheaper than a branch that is taken half
/// of the time.
struct Writer {
  std::uint8_t* points;
  std::uint16_t* columns;
  std::size_t count;

  explicit Writer(const PointSink& sink)
      : points(reinterpret_cast<std::uint8_t*>(sink.points)),
        columns(sink.columns),
        count(sink.count) {}

  /// Address of the next point.
  std::uint8_t* at() const { return points + sizeof(Point) * count; }

  void put(const Float4& position_and_intensity, std::uint64_t rest, bool keep) {
    std::memcpy(at(), &position_and_intensity, kHalf);
    std::memcpy(at() + kHalf, &rest, sizeof rest);
    count += keep;
  }

  /// Sets the column of the next points, as many as the channels of one column can give.
  void fill_columns(std::uint16_t column, int returns) {
    const Columns filled = column - Columns{};
    std::uint16_t* to = columns + count;
    for (int i = 0; i < returns; ++i) {
      std::memcpy(to + std::ptrdiff_t{kChannelsPerColumn} * i, &filled, sizeof filled);
    }
  }
};

inline std::uint16_t column_of(const BlockFrame& frame, const BeamTables& beams,
                               std::size_t channel) {
  return static_cast<std::uint16_t>(frame.column + beams.column[channel / kChannelsPerColumn]);
}

}  // namespace zloam::driver::velodyne
