#include "common/runtime/map_output.hpp"

#include <filesystem>
#include <nlohmann/json.hpp>
#include <utility>

#include "common/runtime/log.hpp"

namespace zloam::runtime {
namespace {

std::string folder_of(const std::string& map_path) {
  if (map_path.empty()) return {};
  const std::string folder = std::filesystem::path(map_path).parent_path().string();
  return folder.empty() ? "." : folder;
}

}  // namespace

MapOutput::MapOutput(Stage& stage, std::string map_path, Write write)
    : stage_(stage),
      map_path_(std::move(map_path)),
      write_(std::move(write)),
      files_(folder_of(map_path_), ".zloam-map-runs") {}

std::string MapOutput::own_path(const OutputFiles::Run& map) const {
  const std::string name = std::filesystem::path(map_path_).filename().string();
  return files_.path(name, files_.suffix(map, {name}));
}

std::string MapOutput::write(const OutputFiles::Run& map) {
  if (map_path_.empty()) return {};
  const std::string path = own_path(map);
  std::string error = write_(path);
  if (error.empty()) error = files_.made(path, map);
  unsaved_ = !error.empty();
  stage_.degraded("map file", error);
  if (!error.empty()) {
    log_error("map not written", {{"reason", error}});
    return error;
  }
  log_info("map written", {{"path", path}, {"points", map.count}});
  return {};
}

std::string MapOutput::write_elsewhere(const std::string& asked, const OutputFiles::Run& map,
                                       std::string& path) {
  const auto place = files_.place(asked);
  path = place.path;
  std::string error = place.error.empty() ? files_.in_the_way(path) : place.error;
  if (error.empty()) error = write_(path);
  if (error.empty()) error = files_.made(path, map);
  return error;
}

CommandReply MapOutput::save(const std::string& arguments_json, const OutputFiles::Run& map) {
  const auto arguments = nlohmann::json::parse(arguments_json.empty() ? "{}" : arguments_json);
  std::string path, error;
  if (arguments.contains("path")) {
    error = write_elsewhere(arguments.at("path").get<std::string>(), map, path);
  } else if (map_path_.empty()) {
    error = "no file: mapping.map_path is not set";
  } else {
    error = write(map);
    path = own_path(map);
  }
  if (!error.empty()) return {false, error, "{}"};
  const nlohmann::json results = {{"path", path}, {"points", map.count}};
  return {true, "map written to " + path, results.dump()};
}

}  // namespace zloam::runtime
