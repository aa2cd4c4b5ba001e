#pragma once
// The two layers of a map's points, as in keys, messages and files.

#include <array>
#include <cstdint>
#include <optional>
#include <string_view>

#include "common/geometry/point.hpp"

namespace zloam {

enum class Layer : std::uint8_t { kEdge = 0, kPlane = 1 };
inline constexpr std::array<Layer, 2> kLayers = {Layer::kEdge, Layer::kPlane};

/// "edge" or "plane", as in keys and files.
inline const char* layer_name(Layer layer) { return layer == Layer::kEdge ? "edge" : "plane"; }

inline std::optional<Layer> layer_from_name(std::string_view name) {
  for (const Layer layer : kLayers) {
    if (name == layer_name(layer)) return layer;
  }
  return std::nullopt;
}

/// A point of the whole map with its layer.
struct LayeredPoint {
  MapPoint point;
  Layer layer;
};

}  // namespace zloam
