#pragma once
// The map as a file: binary PCD 0.7, fields x y z intensity (float32) and layer (uint8: 0 edge,
// 1 plane), in the order given. Nothing of time, host or path goes into it: equal maps are equal
// bytes. Format: the PCD page of the Point Cloud Library's documentation.

#include <span>
#include <string>

#include "mapping/mapping.hpp"

namespace zloam::mapping {

/// The whole file's bytes.
std::string pcd_bytes(std::span<const LayeredPoint> points);

/// Writes to a temporary name in the same folder, syncs, and renames it over `path`; creates the
/// folder. Returns an empty string, or a sentence on what failed (then `path` is as it was).
std::string write_map(const std::string& path, std::span<const LayeredPoint> points);

}  // namespace zloam::mapping
