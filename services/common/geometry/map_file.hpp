#pragma once
// The map as a file: binary PCD 0.7, fields x y z intensity (float32) and layer (uint8: 0 edge,
// 1 plane), in the order given. It contains no time, host or path: equal maps are equal bytes.
// Format: the PCD page of the Point Cloud Library's documentation.

#include <functional>
#include <string>
#include <vector>

#include "common/geometry/map_layer.hpp"

namespace zloam {

/// Returns a map's points part by part, so that they are never all in memory; an empty part is the
/// end.
using NextPoints = std::function<std::vector<LayeredPoint>()>;

/// Writes `count` points to a temporary name in the same folder, syncs, and renames it over `path`;
/// creates the folder. Returns an empty string, or a sentence that says what failed (then `path` is
/// unchanged).
std::string write_map(const std::string& path, std::size_t count, const NextPoints& next);

}  // namespace zloam
