#pragma once
// Worlds described in YAML files; the format is in the README of this folder.

#include <memory>
#include <string>

#include "simulator/scenes.hpp"

namespace zloam::simulator {

/// Reads a scene. Throws std::invalid_argument that names file, line and key for anything unknown,
/// missing or out of range.
std::shared_ptr<const Scene> read_scene(const std::string& path, const SceneOptions& options);

}  // namespace zloam::simulator
