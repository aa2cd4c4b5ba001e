#include "aloam/odometry/odometry_stage.hpp"

#include <algorithm>
#include <chrono>
#include <string>
#include <utility>

#include "aloam/core/clouds.hpp"
#include "aloam/core/scan_registration.hpp"
#include "aloam/covariance.hpp"
#include "common/runtime/recall.hpp"
#include "common/runtime/replicas.hpp"

namespace zloam::aloam {
namespace {

// Replicas of registration need the progress to know which sweeps are still missing.
constexpr std::chrono::milliseconds kProgressPeriod{50};

PointVector in_base(PointSpan points, const Pose& T_base_lidar) {
  PointVector out;
  out.reserve(points.size());
  for (const Point& p : points) out.push_back(moved(p, T_base_lidar));
  return out;
}

void append(std::vector<MapPoint>& out, PointSpan points) {
  for (const Point& p : points) out.push_back({p.x, p.y, p.z, p.intensity});
}

ScanView view_of(const msg::Features& features) {
  return {features.header()->stamp_ns(),
          features.period_ns(),
          features.deskewed(),
          points_of(features.sharp()),
          points_of(features.less_sharp()),
          points_of(features.flat()),
          points_of(features.less_flat())};
}

}  // namespace

OdometryStage::OdometryStage(runtime::Stage& stage, const AloamConfig& config)
    : stage_(stage),
      odometry_(config.deskew),
      T_base_lidar_(stage.shared().mounting.T_base_lidar()),
      pose_(stage.outlet(Key::kOdometry)),
      features_(stage.outlet(Key::kOdometryFeatures)),
      sweep_(stage.outlet(Key::kOdometrySweep)),
      progress_(stage.outlet(Key::kProgress)),
      deskew_(config.deskew) {
  runtime::InletOptions options = runtime::from_replicas(stage, "registration");
  options.on_given_up = [this](std::uint64_t, std::uint64_t sweep, std::string_view) {
    next_sweep_ = std::max(next_sweep_, sweep + 1);
  };
  inlet_ = &stage.inlet<msg::Features>(Key::kFeatures, options,
                                       [this](const Features& f) { return take(f); });
  stage.answer(stage.keys().of(Key::kPathOdometry),
               [this](runtime::Answer& answer) { answer_path(answer); });
  stage.command("reset", [this](const std::string&) { return reset(); });
  stage.on_new_run([this](const msg::Header& first) { new_run(first); });
  stage.every(kProgressPeriod, [this] {
    if (!path_.empty()) publish_progress(progress_.header(stage_.now_ns(), stage_.now_ns()));
  });
}

void OdometryStage::new_run(const msg::Header& first) {
  const bool was_in_run = std::exchange(in_run_, true);
  next_sweep_ = 0;
  if (was_in_run && runtime::goes_on(first, last_instant_ns_)) {
    runtime::report(stage_, {1, 0, first.stamp_ns() - last_instant_ns_});
    return;
  }
  odometry_.reset();
  path_.clear();
  prev_sweep_.reset();
  // In a replay everything, including the epoch, is a function of the capture.
  odom_epoch_ = was_in_run && !first.replay() ? odom_epoch_ + 1 : 0;
  if (!was_in_run && !(first.replay() && first.sweep() == 0)) restart(first);
}

runtime::Outcome OdometryStage::take(const Features& features) {
  // Already done, by the previous instance or while catching up.
  if (features.sweep() < next_sweep_) return runtime::Outcome::kNotMine;
  process(features);
  return runtime::Outcome::kProcessed;
}

OdometryStage::Located OdometryStage::locate(const Features& features) {
  const ScanView view = view_of(*features);
  Located located;
  located.motion = odometry_.process(view);
  located.instant_ns = located.motion.instant_ns;
  located.T_odom_base = T_base_lidar_ * located.motion.T_odom_lidar * T_base_lidar_.inverse();
  const Pose step = T_base_lidar_ * located.motion.step * T_base_lidar_.inverse();
  if (features->period_ns() > 0)
    located.twist_per_s = log_se3(step) * (1e9 / (located.motion.periods * features->period_ns()));
  const bool empty = view.less_sharp.empty() && view.less_flat.empty();
  located.health = empty                                    ? Health::kEmpty
                   : prev_sweep_ && !located.motion.matched ? Health::kPredicted
                                                            : health_of(features->health());
  return located;
}

void OdometryStage::process(const Features& features) {
  next_sweep_ = std::max(next_sweep_, features.sweep() + 1);
  // Registration dropped this sweep and reports it as dropped, so it gets no pose.
  if (health_of(features->health()) == Health::kDropped) return;
  stage_.configure_for(features);
  stage_.degraded("slices", slices_error(features->slices()));
  const Located located = locate(features);
  publish_pose(features, located);
  publish_features(features, located);
  last_instant_ns_ = located.instant_ns;
  prev_sweep_ = features.sweep();
  path_.emplace_back(located.instant_ns, features.sweep(), to_message(located.T_odom_base));
  publish_progress(progress_.header(features));
  note_figures(located);
}

void OdometryStage::publish_pose(const Features& features, const Located& located) {
  OdometryFields fields;
  fields.instant_ns = located.instant_ns;
  fields.T_odom_base = located.T_odom_base;
  fields.twist_per_s = located.twist_per_s;
  fields.covariance = nominal_covariance(kStep);
  fields.solve = {located.motion.iterations, located.motion.lines + located.motion.surfaces,
                  located.motion.residual_m};
  fields.health = located.health;
  fields.prev_sweep = prev_sweep_.value_or(features.sweep());
  HeaderFields header = pose_.header(features);
  header.frame = "odom";
  header.odom_epoch = odom_epoch_;
  pose_.publish(header, build(header, fields));
  last_header_ = header;
}

void OdometryStage::publish_features(const Features& features, const Located& located) {
  const PointVector edges = in_base(located.motion.edges, T_base_lidar_);
  const PointVector planes = in_base(located.motion.planes, T_base_lidar_);
  OdometryFeaturesFields fields;
  fields.instant_ns = located.instant_ns;
  fields.T_odom_base = located.T_odom_base;
  // The message must contain the twist by which the points were moved.
  if (deskew_) fields.twist_per_s = located.twist_per_s;
  fields.covariance = nominal_covariance(kStep);
  fields.period_ns = features->period_ns();
  fields.T_base_lidar = T_base_lidar_;
  fields.edges = edges;
  fields.planes = planes;
  fields.prev_sweep = prev_sweep_.value_or(features.sweep());
  fields.health = located.health;
  fields.range_noise_m = features->range_noise_m();
  HeaderFields header = features_.header(features);
  header.frame = "base_link";
  header.odom_epoch = odom_epoch_;
  features_.publish(header, build(header, fields));
  if (!sweep_.matching()) return;
  std::vector<MapPoint> points;
  append(points, edges);
  append(points, planes);
  header = sweep_.header(features);
  header.frame = "base_link";
  header.odom_epoch = odom_epoch_;
  sweep_.publish(header,
                 build(header, CloudFields{.instant_ns = located.instant_ns, .points = points}));
}

void OdometryStage::publish_progress(HeaderFields header) {
  runtime::publish_progress(stage_, progress_, *inlet_, std::move(header), last_header_.run,
                            next_sweep_);
}

void OdometryStage::note_figures(const Located& located) {
  stage_.figure("iterations", located.motion.iterations);
  stage_.figure("correspondences", located.motion.lines + located.motion.surfaces);
  stage_.figure("residual_m", located.motion.residual_m);
}

void OdometryStage::answer_path(runtime::Answer& answer) const {
  answer.reply(stage_.keys().of(Key::kPathOdometry), encoding_of(Key::kPathOdometry),
               build_path(last_header_, path_));
}

runtime::CommandReply OdometryStage::reset() {
  odometry_.reset();
  prev_sweep_.reset();
  ++odom_epoch_;
  return {true, "a new odom frame begins with the next sweep",
          "{\"odom_epoch\": " + std::to_string(odom_epoch_) + "}"};
}

}  // namespace zloam::aloam
