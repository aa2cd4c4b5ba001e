#pragma once
// The map as a file: binary PCD 0.7, fields x y z intensity (float32) and layer (uint8: 0 edge,
// 1 plane), in the order given. Nothing of time, host or path goes into it: equal maps are equal
// bytes. Format: the PCD page of the Point Cloud Library's documentation.

#include <functional>
#include <string>
#include <vector>

#include "common/geometry/map_layer.hpp"

namespace zloam {

/// Gives a map's points part by part, so that they need never be there whole; an empty part is the
/// end.
using NextPoints = std::function<std::vector<LayeredPoint>()>;

/// Writes `count` points to a temporary name in the same folder, syncs, and renames it over `path`;
/// creates the folder. Returns an empty string, or a sentence on what failed (then `path` is as it
/// was).
std::string write_map(const std::string& path, std::size_t count, const NextPoints& next);

}  // namespace zloam
