#pragma once
// The file of a mapping stage's map: each map has its own in the folder of mapping.map_path, and
// the command `save` writes only below that folder (output_files.hpp).

#include <functional>
#include <string>

#include "common/runtime/output_files.hpp"
#include "common/runtime/stage.hpp"

namespace zloam::runtime {

class MapOutput {
 public:
  /// Writes the map to a path. Empty, or a sentence that says what failed.
  using Write = std::function<std::string(const std::string& path)>;

  /// Empty `map_path`: no file.
  MapOutput(Stage& stage, std::string map_path, Write write);

  /// The map may differ from its file.
  void changed(bool yes) { unsaved_ |= yes; }
  bool unsaved() const { return unsaved_; }
  /// Writes the map's own file; the stage is degraded, and the map unsaved, until writing succeeds.
  /// `map`: its id, and its points.
  std::string write(const OutputFiles::Run& map);
  /// The command: {"path": "..."} for another file in the folder, or below.
  CommandReply save(const std::string& arguments_json, const OutputFiles::Run& map);

 private:
  std::string own_path(const OutputFiles::Run& map) const;
  std::string write_elsewhere(const std::string& asked, const OutputFiles::Run& map,
                              std::string& path);

  Stage& stage_;
  std::string map_path_;
  Write write_;
  OutputFiles files_;
  bool unsaved_ = false;
};

}  // namespace zloam::runtime
