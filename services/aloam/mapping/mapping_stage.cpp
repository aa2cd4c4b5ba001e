#include "aloam/mapping/mapping_stage.hpp"

#include <utility>

#include "aloam/covariance.hpp"
#include "aloam/mapping/map_points.hpp"
#include "common/runtime/recall.hpp"

namespace zloam::aloam {
namespace {

// Kept for a restarted odometry, which computes its last step from the last two.
constexpr std::size_t kCommitsKept = 4;

}  // namespace

MappingStage::MappingStage(runtime::Stage& stage, const OutputConfig& output)
    : stage_(stage),
      output_(output),
      leaves_(defaults_of(stage.shared().sensor.model).leaves),
      mapper_(leaves_),
      correction_(stage.outlet(Key::kMapCorrection)),
      pose_(stage.outlet(Key::kMapOdometry)),
      tile_(stage.outlet_at(Key::kMapTile, stage.keys().all_tiles())),
      surround_(stage.outlet(Key::kMapSurround)),
      cloud_(stage.outlet(Key::kMapCloud)),
      registered_(stage.outlet(Key::kSweepRegistered)),
      ack_(stage.flow_ack("mapping")),
      file_(stage, output.map_path, [this](const std::string& path) { return write_to(path); }) {
  runtime::InletOptions options;
  options.sweeps = runtime::SweepSet::kPublisherDecides;
  options.newest = 4;
  options.keep = kCommitsKept;
  stage.inlet<msg::OdometryFeatures>(Key::kOdometryFeatures, options,
                                     [this](const Sweep& sweep) { return take(sweep); });
  declare_answers();
  stage.on_new_run([this](const msg::Header& first) { new_run(first); });
  stage.on_end_of_run([this](std::uint64_t) {
    // If writing fails, it is tried again when the stage stops.
    file_.write(file_run());
  });
  stage.on_stop([this] {
    if (last_mapped_ && tile_.matching()) publish_tiles(*last_mapped_);
    if (!file_.unsaved()) return;
    const std::string error = file_.write(file_run());
    if (!error.empty()) throw runtime::IoError(error);
  });
}

void MappingStage::new_run(const msg::Header& first) {
  const bool was_in_run = std::exchange(in_run_, true);
  next_sweep_ = 0;
  prev_sweep_.reset();
  if (was_in_run && runtime::goes_on(first, last_instant_ns_, runtime::kLongestSearch_ns)) {
    runtime::report(stage_, {1, 0, first.stamp_ns() - last_instant_ns_});
    return;
  }
  if (file_.unsaved()) stage_.lost_output(file_.write(file_run()));
  mapper_ = ScanToMap(leaves_);
  // What was missing of the map before is not missing of this one.
  for (const char* topic : {"map", "recall"}) stage_.degraded(topic, "");
  path_.clear();
  unpublished_.clear();
  last_mapped_.reset();
  odom_epoch_.reset();
  mapped_ = 0;
  map_id_ = first.run();
  replay_ = first.replay();
  if (was_in_run) return;
  if (!(first.replay() && first.sweep() == 0)) restart(first);
  // Declared last, as this stage can't answer queries for tiles while it requests them itself.
  stage_.answer(stage_.keys().all_tiles(), [this](runtime::Answer& a) { answer_tiles(a); });
}

runtime::Outcome MappingStage::take(const Sweep& sweep) {
  if (sweep.sweep() < next_sweep_) return runtime::Outcome::kNotMine;
  process(sweep);
  return runtime::Outcome::kProcessed;
}

void MappingStage::process(const Sweep& sweep) {
  stage_.configure_for(sweep);
  const Pose T_odom_base = pose_of(sweep->pose_odom_base());
  const std::uint32_t epoch = sweep.header().odom_epoch();
  if (odom_epoch_ && *odom_epoch_ != epoch) mapper_.continue_from(T_odom_base);
  const bool first = !odom_epoch_ && mapper_.map().point_count() == 0;
  odom_epoch_ = epoch;
  const PointSpan edges = points_of(sweep->edges()), planes = points_of(sweep->planes());
  const Mapped mapped = mapper_.process(edges, planes, T_odom_base);
  const Health health = edges.empty() && planes.empty() ? Health::kEmpty
                        : mapped.matched || first       ? Health::kOk
                                                        : Health::kPredicted;
  publish_pose(sweep, mapped, health);
  note_figures(mapped);
  const std::vector<CubeIndex> changed = mapper_.map().take_changed();
  unpublished_.insert(changed.begin(), changed.end());
  file_.changed(!changed.empty());
  prev_sweep_ = sweep.sweep();
  last_mapped_ = sweep;
  ++mapped_;
  publish_views(sweep);
  ack_.done_below(sweep.run(), sweep.sweep() + 1);
}

Vector6 MappingStage::twist_since(std::int64_t instant_ns, const Pose& T_map_base) const {
  const double seconds = 1e-9 * static_cast<double>(instant_ns - last_instant_ns_);
  if (!prev_sweep_ || !(seconds > 0.0)) return Vector6::Zero();
  return log_se3(last_T_map_base_.inverse() * T_map_base) / seconds;
}

void MappingStage::publish_pose(const Sweep& sweep, const Mapped& mapped, Health health) {
  MapCorrectionFields correction;
  correction.instant_ns = sweep->instant_ns();
  correction.T_map_odom = mapper_.T_map_odom();
  correction.covariance = nominal_covariance(kMapped);
  correction.health = health;
  // A-LOAM inserts every sweep.
  correction.inserted = true;
  correction.solve = {mapped.iterations, mapped.lines + mapped.planes, mapped.residual_m};
  correction.prev_sweep = prev_sweep_.value_or(sweep.sweep());
  HeaderFields header = correction_.header(sweep);
  header.frame = "map";
  header.map_id = map_id_;
  correction_.publish(header, build(header, correction));

  MapPoseFields pose;
  pose.instant_ns = sweep->instant_ns();
  pose.T_map_base = mapped.T_map_base;
  pose.twist_per_s = twist_since(pose.instant_ns, pose.T_map_base);
  pose.covariance = correction.covariance;
  pose.correction_sweep = sweep.sweep();
  pose.has_correction = true;
  pose.health = health;
  header = pose_.header(sweep);
  header.frame = "map";
  header.map_id = map_id_;
  pose_.publish(header, build(header, pose));
  path_.emplace_back(pose.instant_ns, sweep.sweep(), to_message(pose.T_map_base));
  last_header_ = header;
  last_instant_ns_ = pose.instant_ns;
  last_T_map_base_ = pose.T_map_base;
}

void MappingStage::publish_views(const Sweep& sweep) {
  const bool last = sweep.end_of_run();
  const bool now = mapped_ % output_.publish_every == 0 || last;
  if (now && tile_.matching()) publish_tiles(sweep);
  if (registered_.matching()) publish_registered(sweep);
  if (now && surround_.matching()) {
    HeaderFields header = surround_.header(sweep);
    header.frame = "map";
    surround_.publish(header, cloud_message(header, false));
  }
  if ((mapped_ % output_.cloud_every == 0 || last) && cloud_.matching()) {
    HeaderFields header = cloud_.header(sweep);
    header.frame = "map";
    cloud_.publish(header, cloud_message(header, true));
  }
}

void MappingStage::publish_tiles(const Sweep& sweep) {
  for (const CubeIndex& index : std::exchange(unpublished_, {})) {
    if (!mapper_.map().cubes().contains(index)) continue;
    for (const Layer layer : kLayers) {
      HeaderFields header = tile_.header(sweep);
      header.frame = "map";
      header.map_id = map_id_;
      const auto& [i, j, k] = index.at;
      tile_.publish_at(stage_.keys().tile(layer_name(layer), i, j, k), header,
                       tile_message(header, index, layer));
    }
  }
}

void MappingStage::publish_registered(const Sweep& sweep) {
  std::vector<MapPoint> points = in_map(points_of(sweep->edges()), last_T_map_base_);
  const std::vector<MapPoint> planes = in_map(points_of(sweep->planes()), last_T_map_base_);
  points.insert(points.end(), planes.begin(), planes.end());
  HeaderFields header = registered_.header(sweep);
  header.frame = "map";
  registered_.publish(header, build(header, CloudFields{.instant_ns = sweep->instant_ns(),
                                                        .points = points,
                                                        .T_frame_base = last_T_map_base_}));
}

void MappingStage::note_figures(const Mapped& mapped) {
  const CubeMap& map = mapper_.map();
  stage_.figure("map_points", static_cast<double>(map.point_count()));
  stage_.figure("map_points_forgotten", static_cast<double>(map.forgotten()));
  stage_.figure("map_tiles", static_cast<double>(map.cubes().size()));
  stage_.figure("correspondences", mapped.lines + mapped.planes);
  stage_.figure("iterations", mapped.iterations);
  stage_.figure("residual_m", mapped.residual_m);
}

}  // namespace zloam::aloam
