// Answers and outputs of A-LOAM's mapping: tiles, clouds, the path, the map's file.

#include <nlohmann/json.hpp>

#include "aloam/mapping/map_points.hpp"
#include "aloam/mapping/mapping_stage.hpp"
#include "common/geometry/map_file.hpp"
#include "common/messages/key_match.hpp"

namespace zloam::aloam {

void bind(runtime::Parameters& p, OutputConfig& c) {
  using runtime::Effect;
  // Its first tile would replace the stored map that the robot is to be found in.
  p.add("mapping.mode", &c.mode, {"map", "localize", "extend"},
        "A-LOAM's mapping can only begin a new map: map");
  p.check("mapping.mode", [&c]() -> std::string {
    if (c.mode == "map") return {};
    return c.mode + " needs the mapping stage itself: A-LOAM's would replace the stored map";
  });
  p.add("mapping.map_path", &c.map_path,
        "PCD file of the map, written at the end of a run; empty: no file", Effect::kNone);
  p.add("mapping.publish_every", &c.publish_every, {1, 10000}, "",
        "publish changed tiles and the surroundings every n-th mapped sweep", Effect::kNone);
  p.add("mapping.cloud_every", &c.cloud_every, {1, 100000}, "",
        "publish the whole map every n-th mapped sweep while there is a subscriber", Effect::kNone);
}

void MappingStage::declare_answers() {
  const auto answer_cloud = [this](Key key, bool whole) {
    stage_.answer(stage_.keys().of(key), [this, key, whole](runtime::Answer& a) {
      a.reply(stage_.keys().of(key), encoding_of(key), cloud_message(last_header_, whole));
    });
  };
  answer_cloud(Key::kMapSurround, false);
  answer_cloud(Key::kMapCloud, true);
  stage_.answer(stage_.keys().of(Key::kPathMap), [this](runtime::Answer& a) {
    a.reply(stage_.keys().of(Key::kPathMap), encoding_of(Key::kPathMap),
            build_path(last_header_, path_));
  });
  // {"path": "..."} for another file in the folder of mapping.map_path, or below.
  stage_.command("save", [this](const std::string& json) { return file_.save(json, file_run()); });
  // Empties the map; the next sweep begins a new one at its pose.
  stage_.command("reset", [this](const std::string&) { return reset(); });
}

Buffer MappingStage::tile_message(const HeaderFields& header, const CubeIndex& index, Layer layer,
                                  bool head) const {
  const Cube& cube = mapper_.map().cubes().at(index);
  std::vector<MapPoint> points;
  if (!head) points = map_points(layer_of(cube, layer));
  MapTileFields fields;
  fields.layer = layer_name(layer);
  fields.i = index.at[0];
  fields.j = index.at[1];
  fields.k = index.at[2];
  fields.edge_m = kCube_m;
  fields.version = cube.version;
  fields.points = points;
  return build(header, fields);
}

Buffer MappingStage::cloud_message(const HeaderFields& header, bool whole) const {
  std::vector<MapPoint> points;
  for (const auto& [index, cube] : mapper_.map().cubes()) {
    if (!whole && !mapper_.map().is_local(index)) continue;
    for (const Layer layer : kLayers) {
      const std::vector<MapPoint> more = map_points(layer_of(cube, layer));
      points.insert(points.end(), more.begin(), more.end());
    }
  }
  return build(header, CloudFields{.instant_ns = last_instant_ns_,
                                   .points = points,
                                   .T_frame_base = last_T_map_base_});
}

// "?heads": the tiles without their points, as the default mapping answers.
void MappingStage::answer_tiles(runtime::Answer& answer) {
  const bool heads = answer.parameters() == "heads";
  for (const auto& [index, cube] : mapper_.map().cubes()) {
    for (const Layer layer : kLayers) {
      const auto& [i, j, k] = index.at;
      const std::string key = stage_.keys().tile(layer_name(layer), i, j, k);
      if (!key_matches(answer.key(), key)) continue;
      answer.reply(key, encoding_of(Key::kMapTile),
                   tile_message(last_header_, index, layer, heads));
    }
  }
}

runtime::CommandReply MappingStage::reset() {
  const Pose T_map_odom = mapper_.T_map_odom();
  mapper_ = ScanToMap(leaves_);
  mapper_.restore(last_T_map_base_, T_map_odom);
  path_.clear();
  unpublished_.clear();
  last_mapped_.reset();
  ++map_id_;
  // Whatever the map before lacked, this one does not.
  for (const char* topic : {"map", "recall"}) stage_.degraded(topic, "");
  const nlohmann::json results = {{"map_id", map_id_}};
  return {true, "map emptied", results.dump()};
}

std::string MappingStage::write_to(const std::string& path) const {
  const auto& cubes = mapper_.map().cubes();
  auto at = cubes.begin();
  return write_map(path, mapper_.map().point_count(), [&] {
    std::vector<LayeredPoint> points;
    while (points.empty() && at != cubes.end()) points = layered_points((at++)->second);
    return points;
  });
}

runtime::OutputFiles::Run MappingStage::file_run() const {
  return {map_id_, replay_, mapper_.map().point_count()};
}

}  // namespace zloam::aloam
