#pragma once
// The one point type of all stages, and the return types.

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <vector>

namespace zloam {

enum class ReturnType : std::uint8_t { kStrongest = 0, kLast = 1, kBoth = 2, kSecondStrongest = 3 };

/// One lidar return; same layout as the message's struct (schemas/common.fbs), so that algorithms
/// read arrays of it in place. x, y, z in metres in the frame that the container names (lidar: x
/// forward, y left, z up); time_ns counts from the sweep's first point; ring is the rank of the
/// laser by ascending elevation.
struct Point {
  float x, y, z;
  float intensity;
  std::uint32_t time_ns;
  std::uint16_t ring;
  ReturnType return_type;
  std::uint8_t reserved;

  Eigen::Vector3f position() const { return {x, y, z}; }
};
static_assert(sizeof(Point) == 24 && alignof(Point) == 4);

/// A point of a map or of a cloud without time; same layout as the message's struct.
struct MapPoint {
  float x, y, z;
  float intensity;
};
static_assert(sizeof(MapPoint) == 16 && alignof(MapPoint) == 4);

using PointSpan = std::span<const Point>;
using PointVector = std::vector<Point>;

}  // namespace zloam
