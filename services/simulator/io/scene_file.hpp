#pragma once
// Worlds described in YAML files; the format is in the README of this folder.

#include <memory>
#include <string>

#include "simulator/scenes.hpp"

namespace zloam::simulator {

/// Reads a scene. Throws std::invalid_argument, naming file, line and key, if anything is unknown,
/// missing or out of range.
std::shared_ptr<const Scene> read_scene(const std::string& path, const SceneOptions& options);

}  // namespace zloam::simulator
