#include "mapping/mapping_stage.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <nlohmann/json.hpp>
#include <numbers>
#include <utility>

#include "common/geometry/map_file.hpp"
#include "common/messages/key_match.hpp"
#include "common/runtime/recall.hpp"
#include "mapping/io/tile_messages.hpp"

namespace zloam::mapping {
namespace {

std::vector<MapPoint> without_layers(const std::vector<LayeredPoint>& points) {
  std::vector<MapPoint> plain;
  plain.reserve(points.size());
  for (const LayeredPoint& p : points) plain.push_back(p.point);
  return plain;
}

WeakFields weak_fields(const Degeneracy& d) {
  return {d.degenerate, d.weak_translation, d.weak_rotation, d.sigma_measured, d.sigma_predicted};
}

void append_in_map(std::vector<MapPoint>& out, PointSpan points, const Pose& T_map_base) {
  for (const Point& p : points) {
    const Eigen::Vector3f q = (T_map_base * p.position().cast<double>()).cast<float>();
    out.push_back({q.x(), q.y(), q.z(), p.intensity});
  }
}

// Odometry messages kept for a restarted odometry: its window of 20 sweeps, the sweep before it,
// and the last one, which it publishes again. Each takes a megabyte.
constexpr std::size_t kCommitsKept = 22;

// Limit of the arguments of `place`, in m or degrees: no map reaches that far.
constexpr double kFarthest = 1e6;

}  // namespace

MappingStage::MappingStage(runtime::Stage& stage, const MappingConfig& config,
                           const OutputConfig& output)
    : stage_(stage),
      config_(config),
      output_(output),
      mapper_(config),
      correction_(stage.outlet(Key::kMapCorrection)),
      pose_(stage.outlet(Key::kMapOdometry)),
      tile_(stage.outlet_at(Key::kMapTile, stage.keys().all_tiles())),
      surround_(stage.outlet(Key::kMapSurround)),
      cloud_(stage.outlet(Key::kMapCloud)),
      registered_(stage.outlet(Key::kSweepRegistered)),
      submap_(stage.outlet(Key::kSubmap)),
      ack_(stage.flow_ack("mapping")),
      file_(stage, output.map_path, [this](const std::string& path) { return write_to(path); }) {
  runtime::InletOptions options;
  options.sweeps = runtime::SweepSet::kPublisherDecides;
  options.newest = 4;
  options.implausible = [this](const runtime::Message& m) {
    const Sweep sweep(m);
    return motion_check_.check(sweep.header().odom_epoch(), sweep->instant_ns(),
                               pose_of(sweep->pose_odom_base()));
  };
  options.keep =
      std::min(kCommitsKept, static_cast<std::size_t>(stage.shared().recovery.keep_messages));
  inlet_ = &stage.inlet<msg::OdometryFeatures>(Key::kOdometryFeatures, options,
                                               [this](const Sweep& sweep) { return take(sweep); });
  started_ns_ = stage.now_ns();
  declare_answers();
  declare_commands();
  stage.on_new_run([this](const msg::Header& first) { new_run(first); });
  stage.on_end_of_run([this](std::uint64_t) {
    // If the file cannot be written now, the stage tries again when it stops.
    file_.write(file_run());
  });
  stage.on_hand_over([this](bool leaves) { leave_map(leaves); });
  stage.on_stop([this] {
    if (last_mapped_) {
      publish_map(*last_mapped_, true);
      if (const auto open = mapper_.finish_submap()) publish_submap(*last_mapped_, open);
    }
    if (!file_.unsaved()) return;
    const std::string error = file_.write(file_run());
    if (!error.empty()) throw runtime::IoError(error);
  });
}

void MappingStage::declare_answers() {
  stage_.answer(stage_.keys().of(Key::kMapSurround),
                [this](runtime::Answer& a) { answer_cloud(a, Key::kMapSurround, false); });
  stage_.answer(stage_.keys().of(Key::kMapCloud),
                [this](runtime::Answer& a) { answer_cloud(a, Key::kMapCloud, true); });
  stage_.answer(stage_.keys().of(Key::kPathMap), [this](runtime::Answer& a) { answer_path(a); });
}

void MappingStage::declare_commands() {
  // {"path": "..."} for another file in the folder of mapping.map_path, or below.
  stage_.command("save", [this](const std::string& json) { return file_.save(json, file_run()); });
  // Empties the map; the next sweep initializes a new one where it is.
  stage_.command("reset", [this](const std::string&) { return reset(); });
  // {"x_m": 1.0, "y_m": 2.0, "yaw_deg": 90.0}: where base_link is in the map, for a robot that is
  // lost or was carried.
  stage_.command("place", [this](const std::string& arguments) { return place(arguments); });
}

void MappingStage::new_run(const msg::Header& first) {
  begin_run(first);
  place_as_told();
}

void MappingStage::begin_run(const msg::Header& first) {
  const bool was_in_run = std::exchange(in_run_, true);
  step_covariance_ = {};
  motion_check_.reset();
  watch_ = {};
  mapped_ = 0;
  next_sweep_ = 0;
  mapper_.new_run();
  if (was_in_run && runtime::goes_on(first, last_instant_ns_, runtime::kLongestSearch_ns)) {
    mapper_.expect_break();
    runtime::report(stage_, {1, 0, first.stamp_ns() - last_instant_ns_});
    return;
  }
  const std::string error = file_.unsaved() ? file_.write(file_run()) : std::string();
  if (was_in_run && config_.mode != MappingMode::kMap) {
    // The map is kept, but how the robot moved between the runs is unknown.
    mapper_.place(last_T_map_base_);
    return;
  }
  stage_.lost_output(error);
  mapper_ = Mapper(config_);
  last_T_map_base_ = Pose::Identity();
  for (const char* topic : {"map", "recall"}) stage_.degraded(topic, "");
  forget_published();
  // The map is named after the run that initialized it.
  map_id_ = first.run();
  replay_ = first.replay();
  if (was_in_run) return;
  const bool has_map = config_.mode != MappingMode::kMap;
  if (has_map || !(first.replay() && first.sweep() == 0)) restart(first);
  if (!lacks_map_) declare_tiles();
}

// Declared after restart(), which requests the same tiles and cannot answer while it waits.
void MappingStage::declare_tiles() {
  stage_.answer(stage_.keys().all_tiles(), [this](runtime::Answer& a) { answer_tiles(a); });
}

MappingInput MappingStage::input_of(const Sweep& sweep) {
  MappingInput input;
  input.sweep = sweep.sweep();
  input.stamp_ns = sweep.header().stamp_ns();
  input.instant_ns = static_cast<std::uint32_t>(sweep->instant_ns() - input.stamp_ns);
  input.period_ns = sweep->period_ns();
  input.odom_epoch = sweep.header().odom_epoch();
  input.T_odom_base = pose_of(sweep->pose_odom_base());
  input.twist_per_s = twist_of(sweep->twist());
  input.T_base_lidar = pose_of(sweep->pose_base_lidar());
  input.edges = points_of(sweep->edges());
  input.planes = points_of(sweep->planes());
  input.health = health_of(sweep->health());
  input.slices = std::max<std::uint32_t>(1, sweep->slices());
  input.degenerate = sweep->degenerate();
  input.range_noise_m = static_cast<double>(sweep->range_noise_m());
  if (mapped_ > 0 && sweep->prev_sweep() == prev_mapped_) input.inertial = inertial_step_of(*sweep);
  return input;
}

runtime::Outcome MappingStage::take(const Sweep& sweep) {
  if (sweep.sweep() < next_sweep_) return runtime::Outcome::kNotMine;
  process(sweep);
  return runtime::Outcome::kProcessed;
}

void MappingStage::process(const Sweep& sweep) {
  if (lacks_map_) ask_for_map(sweep.header());
  if (stage_.configure_for(sweep)) mapper_.configure(config_);
  MappingInput input = input_of(sweep);
  step_covariance_.add(input.sweep, sweep->prev_sweep(), input.T_odom_base,
                       covariance_of(sweep->covariance()));
  watch_.see(input.sweep, sweep->prev_sweep(), sweep->instant_ns());
  // The last one whatever its number: store and graph learn from it that the run ends.
  if (input.is_mapped(config_.every) || sweep.end_of_run()) {
    input.step_covariance = step_covariance_.take();
    input.unwatched_s = watch_.take();
    const MappingResult result = mapper_.process(input);
    // A map that comes late is searched from there.
    if (!lacks_map_) told_.reset();
    publish_pose(sweep, result);
    note_figures(result);
    file_.changed(result.inserted);
    unpublished_.insert(result.changed.begin(), result.changed.end());
    publish_submap(sweep, result.submap);
    publish_views(sweep, result);
    prev_mapped_ = input.sweep;
    last_mapped_ = sweep;
    ++mapped_;
  }
  ack_.done_below(sweep.run(), sweep.sweep() + 1);
}

void MappingStage::publish_pose(const Sweep& sweep, const MappingResult& result) {
  MapCorrectionFields correction;
  correction.instant_ns = sweep->instant_ns();
  correction.T_map_odom = result.T_map_odom;
  correction.covariance = result.covariance;
  correction.health = result.health;
  correction.inserted = result.inserted;
  correction.weak = weak_fields(result.degeneracy);
  correction.solve = {result.iterations, result.correspondences, result.residual_m};
  correction.prev_sweep = mapped_ > 0 ? prev_mapped_ : result.sweep;
  const std::vector<std::uint64_t> state = mapper_.state();
  correction.state = state;
  HeaderFields header = correction_.header(sweep);
  header.frame = "map";
  header.map_id = map_id_;
  correction_.publish(header, build(header, correction));

  MapPoseFields pose;
  pose.instant_ns = sweep->instant_ns();
  pose.T_map_base = result.T_map_base;
  pose.twist_per_s = twist_of(sweep->twist());
  pose.covariance = result.covariance;
  pose.correction_sweep = result.sweep;
  pose.has_correction = true;
  pose.health = result.health;
  pose.weak = correction.weak;
  header = pose_.header(sweep);
  header.frame = "map";
  header.map_id = map_id_;
  pose_.publish(header, build(header, pose));
  last_header_ = header;
  last_pose_ = {header, pose};
  last_instant_ns_ = pose.instant_ns;
  last_T_map_base_ = result.T_map_base;
}

void MappingStage::publish_views(const Sweep& sweep, const MappingResult& result) {
  const bool last = sweep.end_of_run();
  publish_map(sweep, last);
  if (registered_.matching()) publish_registered(sweep, result);
  if ((mapped_ % output_.publish_every == 0 || last) && surround_.matching()) {
    HeaderFields header = surround_.header(sweep);
    header.frame = "map";
    surround_.publish(header, cloud_message(header, mapper_.surround()));
  }
  if ((mapped_ % output_.cloud_every == 0 || last) && cloud_.matching()) {
    HeaderFields header = cloud_.header(sweep);
    header.frame = "map";
    cloud_.publish(header, cloud_message(header, mapper_.cloud()));
  }
}

void MappingStage::publish_map(const Sweep& sweep, bool all) {
  if (!tile_.matching()) return;
  if (mapped_ % output_.publish_every == 0 || all) {
    publish_tiles(sweep, all ? 0.0 : output_.publish_growth);
  }
  if (mapped_ % output_.voxels_every == 0 || all) {
    publish_voxels(sweep, all ? 0.0 : output_.voxels_growth);
  }
}

// The last message of a run marks its end and is sent even if there is no submap left to publish.
void MappingStage::publish_submap(const Sweep& sweep, const std::optional<Submap>& submap) {
  // Published from the first subscriber on, even while there is none: a restarted subscriber
  // requests the submaps that it missed.
  submaps_read_ = submaps_read_ || submap_.matching();
  if (!submaps_read_ || config_.submap_m <= 0.0) return;
  std::optional<Submap> closed = submap;
  if (sweep.end_of_run() && !closed) closed = mapper_.finish_submap();
  if (sweep.end_of_run() && !closed) {
    closed.emplace();
    closed->first_sweep = closed->last_sweep = closed->sweep = closed->before_sweep = sweep.sweep();
    closed->instant_ns = sweep->instant_ns();
  }
  if (!closed) return;
  HeaderFields header = submap_.header(sweep);
  header.frame = "base_link";
  header.map_id = map_id_;
  submap_.publish(header, build(header, *closed));
}

void MappingStage::publish_tiles(const Sweep& sweep, double growth) {
  for (auto next = unpublished_.begin(); next != unpublished_.end();) {
    const TileId id = *next;
    const std::uint64_t count = mapper_.tile_count(id);
    std::uint64_t& published = published_[id];
    const double enough = (1.0 + growth) * static_cast<double>(published);
    // A tile that has left the window (count 0) no longer grows and is published as it is.
    if (count > 0 && static_cast<double>(count) <= enough) {
      ++next;
      continue;
    }
    next = unpublished_.erase(next);
    published = count;
    const std::optional<Tile> tile = mapper_.tile(id);
    if (!tile) continue;
    HeaderFields header = tile_.header(sweep);
    header.frame = "map";
    header.map_id = map_id_;
    const TileIndex& at = id.index;
    tile_.publish_at(stage_.keys().tile(layer_name(id.layer), at.i, at.j, at.k), header,
                     tile_message(header, *tile));
  }
}

void MappingStage::forget_published() {
  unpublished_.clear();
  published_.clear();
  last_mapped_.reset();
}

void MappingStage::publish_registered(const Sweep& sweep, const MappingResult& result) {
  CloudFields cloud;
  std::vector<MapPoint> points;
  append_in_map(points, points_of(sweep->edges()), result.T_map_base);
  append_in_map(points, points_of(sweep->planes()), result.T_map_base);
  cloud.instant_ns = sweep->instant_ns();
  cloud.points = points;
  cloud.T_frame_base = result.T_map_base;
  HeaderFields header = registered_.header(sweep);
  header.frame = "map";
  registered_.publish(header, build(header, cloud));
}

void MappingStage::note_figures(const MappingResult& result) {
  stage_.degraded("archive", mapper_.archive_fault());
  stage_.figure("map_points", static_cast<double>(mapper_.point_count()));
  stage_.figure("map_tiles", static_cast<double>(mapper_.tiles().size()));
  stage_.figure("correspondences", result.correspondences);
  stage_.figure("iterations", result.iterations);
  stage_.figure("residual_m", result.residual_m);
  stage_.figure("inserted", result.inserted ? 1.0 : 0.0);
  stage_.figure("degenerate", result.degeneracy.degenerate ? 1.0 : 0.0);
}

Buffer MappingStage::cloud_message(const HeaderFields& header,
                                   const std::vector<LayeredPoint>& points) const {
  const std::vector<MapPoint> plain = without_layers(points);
  CloudFields fields;
  fields.instant_ns = last_instant_ns_;
  fields.points = plain;
  fields.T_frame_base = last_T_map_base_;
  return build(header, fields);
}

// "?heads": the tiles without their points, for a reader who gets one after the other at the pace of
// its link. All at once pile up before a slow link, and Zenoh then closes this stage's.
void MappingStage::answer_tiles(runtime::Answer& answer) {
  for (const VoxelTile& tile : left_voxels_) {
    const std::string key = voxel_key(tile.index);
    if (!key_matches(answer.key(), key)) continue;
    answer.reply(key, encoding_of(Key::kMapTile), voxel_message(last_header_, tile));
  }
  const bool heads = answer.parameters() == "heads";
  for (const TileId& id : mapper_.tiles()) {
    const TileIndex& at = id.index;
    const std::string key = stage_.keys().tile(layer_name(id.layer), at.i, at.j, at.k);
    if (!key_matches(answer.key(), key)) continue;
    std::optional<Tile> tile = mapper_.tile(id);
    if (!tile) continue;
    if (heads) {
      tile->points.clear();
      tile->counts.clear();
    }
    answer.reply(key, encoding_of(Key::kMapTile), tile_message(last_header_, *tile));
  }
}

void MappingStage::answer_cloud(runtime::Answer& answer, Key key, bool whole) {
  answer.reply(stage_.keys().of(key), encoding_of(key),
               cloud_message(last_header_, whole ? mapper_.cloud() : mapper_.surround()));
}

void MappingStage::answer_path(runtime::Answer& answer) {
  std::vector<msg::StampedPose> poses;
  for (const PathPose& p : mapper_.path()) {
    poses.emplace_back(p.instant_ns, p.sweep, to_message(p.T_map_base));
  }
  answer.reply(stage_.keys().of(Key::kPathMap), encoding_of(Key::kPathMap),
               build_path(last_header_, poses));
}

runtime::CommandReply MappingStage::reset() {
  if (config_.mode == MappingMode::kLocalize) {
    return {false, "mapping.mode is localize: the map stays as it is", "{}"};
  }
  mapper_.reset();
  told_.reset();
  forget_published();
  ++map_id_;
  // Whatever the map before lacked, this one does not.
  for (const char* topic : {"map", "recall"}) stage_.degraded(topic, "");
  if (std::exchange(lacks_map_, false)) declare_tiles();
  const nlohmann::json results = {{"map_id", map_id_}};
  return {true, "map emptied", results.dump()};
}

runtime::CommandReply MappingStage::place(const std::string& arguments_json) {
  const auto arguments = nlohmann::json::parse(arguments_json.empty() ? "{}" : arguments_json);
  std::array<double, 3> values{};
  constexpr std::array kNames = {"x_m", "y_m", "yaw_deg"};
  for (std::size_t i = 0; i < kNames.size(); ++i) {
    const auto found = arguments.find(kNames[i]);
    if (found == arguments.end() || !found->is_number()) {
      return {false, std::string(kNames[i]) + " is missing, or no number", "{}"};
    }
    values[i] = found->get<double>();
    if (!(std::abs(values[i]) < kFarthest)) {
      return {false, std::string(kNames[i]) + " is out of reach", "{}"};
    }
  }
  told_ = ToldPlace{values[0], values[1], values[2] * std::numbers::pi / 180.0};
  place_as_told();
  return {true, "from the next sweep on the robot is searched for around there", "{}"};
}

// Height, roll and pitch are kept from the last pose: a user cannot give them better.
void MappingStage::place_as_told() {
  if (!told_) return;
  const Eigen::Matrix3d& R = last_T_map_base_.linear();
  const double turn_rad = told_->yaw_rad - std::atan2(R(1, 0), R(0, 0));
  Pose T_map_base = last_T_map_base_;
  T_map_base.linear() = Eigen::AngleAxisd(turn_rad, Eigen::Vector3d::UnitZ()) * R;
  T_map_base.translation().head<2>() << told_->x_m, told_->y_m;
  mapper_.place(normalised(T_map_base));
}

// Writes tile by tile: otherwise the map would be in memory a second time as one cloud and a third
// time as bytes.
std::string MappingStage::write_to(const std::string& path) const {
  const std::vector<TileId> tiles = mapper_.tiles();
  auto at = tiles.begin();
  return write_map(path, mapper_.point_count(), [&] {
    std::vector<LayeredPoint> points;
    while (points.empty() && at != tiles.end()) points = mapper_.tile_points(*at++);
    return points;
  });
}

runtime::OutputFiles::Run MappingStage::file_run() const {
  return {map_id_, replay_, mapper_.point_count()};
}

}  // namespace zloam::mapping
