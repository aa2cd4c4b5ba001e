#include "ros/ros_stage.hpp"

#include <algorithm>
#include <chrono>
#include <iterator>
#include <nlohmann/json.hpp>
#include <numbers>
#include <optional>
#include <utility>

#include "common/runtime/log.hpp"
#include "common/runtime/read.hpp"
#include "common/runtime/recall.hpp"
#include "common/zenoh/aligned.hpp"
#include "schemas/status_generated.h"

namespace zloam::ros {
namespace {

using std::chrono::milliseconds;

// Periods of polling for clouds and of slower topics. The whole map is large, so it is published
// less often still.
constexpr milliseconds kLook{20}, kSecond{1000};
constexpr std::int64_t kMapPeriod_ns = 5'000'000'000;
constexpr milliseconds kPlacedWithin{5000};
// A stage publishes its status every second.
constexpr std::int64_t kSilent_ns = 5'000'000'000;
// A node is listed within a second of its start.
constexpr std::int64_t kPatience_ns = 10'000'000'000;
// Received messages determine the number of entries; these limits, above what any robot has, bound
// the memory that an unknown sender can occupy.
constexpr std::size_t kMostWaitingClouds = 2;
constexpr std::size_t kNewestStatuses = 256, kNewestTiles = 4096, kNewestReadings = 4096;

const Qos kReliable{};
const Qos kSensor{.best_effort = true, .transient_local = false, .depth = 5};
const Qos kLatched{.best_effort = false, .transient_local = true, .depth = 1};
// QoS of tf2_ros's broadcasters.
const Qos kTransforms{.best_effort = false, .transient_local = false, .depth = 100};

/// Whether a pose of this health is confirmed by the map.
bool is_placed(Health health) {
  return health != Health::kLost && health != Health::kBridging && health != Health::kDropped &&
         health != Health::kInvalid;
}

DiagnosticLevel level_of(msg::ServiceHealth health) {
  if (health == msg::ServiceHealth::Ready) return DiagnosticLevel::kOk;
  return health == msg::ServiceHealth::Failed ? DiagnosticLevel::kError : DiagnosticLevel::kWarning;
}

Diagnostic diagnostic_of(const msg::Status& status) {
  const auto text = [](const flatbuffers::String* s) { return s == nullptr ? "" : s->str(); };
  Diagnostic d;
  d.level = level_of(status.health());
  d.name = "zenoh-loam: " + text(status.stage());
  d.message = msg::EnumNameServiceHealth(status.health());
  if (const std::string reason = text(status.reason()); !reason.empty()) d.message += ": " + reason;
  d.hardware = text(status.robot()) + " " + text(status.instance());
  if (status.figures() == nullptr) return d;
  for (const msg::Figure* figure : *status.figures()) {
    d.values.emplace_back(text(figure->name()), std::to_string(figure->value()));
  }
  return d;
}

}  // namespace

RosStage::RosStage(runtime::Stage& stage, const RosConfig& config)
    : stage_(stage),
      config_(config),
      node_(config, "zenoh_loam"),
      clouds_(stage.session(), stage.keys().of(Key::kSweepRegistered), 1),
      tiles_(stage.session(), stage.keys().all_tiles(), kNewestTiles),
      statuses_(stage.session(), stage.keys().status("*", "*"), kNewestStatuses),
      readings_(kNewestReadings),
      places_(1),
      all_tiles_(stage, "/map"),
      began_ns_(runtime::steady_ns()) {
  odometry_ = node_.publish(topic("odom"), kOdometryType, kReliable);
  pose_ = node_.publish(topic("pose"), kPoseType, kReliable);
  transforms_ = node_.publish("/tf", kTransformsType, kTransforms);
  static_transforms_ = node_.publish("/tf_static", kTransformsType, kLatched);
  path_ = node_.publish(topic("path"), kPathType, kLatched, Size::kLarge);
  points_ = node_.publish(topic("points"), kCloudType, kSensor, Size::kLarge);
  map_ = node_.publish(topic("map"), kCloudType, kLatched, Size::kLarge);
  diagnostics_ = node_.publish("/diagnostics", kDiagnosticsType, kReliable);
  say_mounting();
  wire();
}

std::string RosStage::topic(const std::string& name) const {
  return config_.name_space.empty() ? "/" + name : "/" + config_.name_space + "/" + name;
}

void RosStage::wire() {
  runtime::InletOptions options;
  options.order = runtime::Order::kAsTheyCome;
  stage_.inlet<msg::Odometry>(Key::kOdometry, options, [this](const auto& m) { take(m); });
  stage_.inlet<msg::MapPose>(Key::kPose, options, [this](const auto& m) { take(m); });
  options.ends_run = false;
  stage_.inlet<msg::MapPose>(Key::kMapOdometry, options, [this](const auto& m) { take_mapped(m); });
  stage_.on_new_run([this](const msg::Header& first) { new_run(first); });
  // Live, a busy machine drops tiles; no later ones replace the last.
  stage_.on_end_of_run([this](std::uint64_t) { all_tiles_.want(); });
  stage_.every(kLook, [this] { say_points(); });
  stage_.every(kSecond, [this] {
    say_path();
    take_tiles();
    say_map();
    say_diagnostics();
    look_for_nodes();
  });
  statuses_.want(true);
  node_.subscribe(topic("initialpose"), kPoseType, kReliable, places_.sink());
  stage_.every(kLook, [this] { take_places(); });
  if (!config_.imu_topic.empty()) {
    imu_ = &stage_.outlet(Key::kImu);
    node_.subscribe(config_.imu_topic, kImuType, kSensor, readings_.sink());
    stage_.every(kLook, [this] { take_imu(); });
  }
}

void RosStage::new_run(const msg::Header& first) {
  // As odometry decides: its frame continues after a short gap.
  if (!runtime::goes_on(first, last_odometry_ns_)) tree_ = {};
  path_of_run_.clear();
  placed_.clear();
  waiting_clouds_.clear();
}

// The map may outlast the run. At the first sweep of the run that began the map, the map starts
// from nothing: a replay of the same capture has the same map_id.
void RosStage::take_mapped(const runtime::Received<msg::MapPose>& m) {
  const std::uint64_t map_id = m.header().map_id();
  path_of_run_.in_map(map_id);
  if (map_id_ != map_id || (m.sweep() == 0 && map_id == m.run())) begin_map(map_id);
}

// All tiles are requested again: some of this map may have arrived, and been dropped, before it was
// known to be the current one.
void RosStage::begin_map(std::uint64_t map_id) {
  map_id_ = map_id;
  // If another map was shown, an empty one must replace it.
  map_grew_ |= !map_tiles_.empty();
  map_tiles_.clear();
  stage_.degraded("map", {});
  all_tiles_.want();
}

void RosStage::take(const runtime::Received<msg::Odometry>& m) {
  replay_ = m.replay();
  OdometryStep step;
  step.run = m.run();
  step.sweep = m.sweep();
  step.epoch = m.header().odom_epoch();
  step.instant_ns = m->instant_ns();
  step.T_odom_base = pose_of(m->pose_odom_base());
  step.step_covariance = covariance_of(m->covariance());
  last_odometry_ns_ = step.instant_ns;
  const PoseTree::Uncertainty uncertainty = tree_.add(step);

  OdometryMessage out;
  out.header = {step.instant_ns, frame("odom")};
  out.child_frame = frame("base_link");
  out.T_frame_child = step.T_odom_base;
  out.twist = twist_of(m->twist());
  out.pose_covariance = uncertainty.pose;
  out.twist_covariance = uncertainty.twist;
  odometry_->put(encode(out), step.instant_ns, replay_);
  const std::vector<TransformMessage> transform = {
      {out.header, out.child_frame, out.T_frame_child}};
  transforms_->put(encode(transform), step.instant_ns, replay_);
  say_corrections();
}

void RosStage::take(const runtime::Received<msg::MapPose>& m) {
  replay_ = m.replay();
  health_ = health_of(m->health());
  last_pose_ns_ = runtime::steady_ns();
  placed_.add(m.sweep(), is_placed(health_));
  if (!is_placed(health_)) return;
  PoseMessage out;
  out.header = {m->instant_ns(), frame("map")};
  out.T_frame_base = pose_of(m->pose_map_base());
  out.covariance = about_frame_axes(out.T_frame_base, covariance_of(m->covariance()));
  pose_->put(encode(out), m->instant_ns(), replay_);
  path_of_run_.add(m->instant_ns(), out.T_frame_base);
  path_grew_ = true;
  tree_.add(MapStep{m.run(), m.sweep(), m->instant_ns(), out.T_frame_base});
  say_corrections();
}

void RosStage::say_corrections() {
  for (const auto& [instant_ns, T_map_odom] : tree_.take_corrections()) {
    const std::vector<TransformMessage> transform = {
        {{instant_ns, frame("map")}, frame("odom"), T_map_odom}};
    transforms_->put(encode(transform), instant_ns, replay_);
  }
}

void RosStage::say_mounting() {
  const runtime::MountingConfig& mounting = stage_.shared().mounting;
  const Stamped header{stage_.now_ns(), frame("base_link")};
  const std::vector<TransformMessage> transforms = {
      {header, frame(stage_.shared().sensor.name), mounting.T_base_lidar()},
      {header, frame("imu"), mounting.T_base_imu()}};
  static_transforms_->put(encode(transforms), header.stamp_ns, replay_);
}

// A cloud waits for its sweep's pose, and is not shown if that is not known: it would lie at the
// wrong place in the map.
void RosStage::say_points() {
  clouds_.want(points_->matching());
  for (zenoh::Sample& sample : clouds_.take()) waiting_clouds_.push_back(std::move(sample));
  while (waiting_clouds_.size() > kMostWaitingClouds) waiting_clouds_.pop_front();
  std::erase_if(waiting_clouds_, [this](const zenoh::Sample& sample) {
    const runtime::Read<msg::Cloud> cloud(Key::kSweepRegistered, sample);
    if (!cloud) return true;
    const std::optional<bool> placed = placed_.find(cloud->header()->sweep());
    if (!placed) return false;
    if (*placed) {
      const Stamped header{cloud->instant_ns(), frame("map")};
      points_->put(encode(CloudMessage{header, map_points_of(cloud->points())}), header.stamp_ns,
                   replay_);
    }
    return true;
  });
}

void RosStage::say_path() {
  if (!path_grew_ || !path_->matching()) return;
  PathMessage out;
  out.poses = path_of_run_.poses();
  out.header = {out.poses.empty() ? stage_.now_ns() : out.poses.back().first, frame("map")};
  path_->put(encode(out), out.header.stamp_ns, replay_);
  path_grew_ = false;
}

void RosStage::take_tile(const zenoh::Sample& sample) {
  const runtime::Read<msg::MapTile> tile(Key::kMapTile, sample);
  if (!tile || tile->points() == nullptr) return;
  const msg::Header& header = *tile->header();
  // Without a current run no pose names the map, so the first tile does.
  if (!map_id_) map_id_ = header.map_id();
  if (map_id_ != header.map_id()) return;
  const ShownTiles::Taken taken =
      map_tiles_.take(tile->layer()->string_view(), sample.key, {header.term(), tile->version()},
                      map_points_of(tile->points()));
  map_grew_ |= taken == ShownTiles::Taken::kTaken;
  if (taken != ShownTiles::Taken::kFull) return;
  stage_.degraded("map",
                  "/map shows " + std::to_string(ShownTiles::kMost) + " tiles; there are more");
}

// When /map gets a subscriber, or another map begins, requests all existing tiles; later ones
// arrive by subscription.
void RosStage::take_tiles() {
  const bool wanted = map_->matching();
  if (tiles_.want(wanted)) all_tiles_.want();
  if (wanted) all_tiles_.ask();
  for (const zenoh::Sample& sample : all_tiles_.take()) take_tile(sample);
  // They are requested again when somebody reads /map again.
  if (!wanted) all_tiles_.no_reader();
  for (const zenoh::Sample& sample : tiles_.take()) take_tile(sample);
}

void RosStage::say_map() {
  const std::int64_t now_ns = runtime::steady_ns();
  if (!map_grew_ || !map_->matching() || now_ns - last_map_ns_ < kMapPeriod_ns) return;
  const std::vector<MapPoint> all = map_tiles_.points();
  const Stamped header{stage_.now_ns(), frame("map")};
  map_->put(encode(CloudMessage{header, all}), header.stamp_ns, replay_);
  map_grew_ = false;
  last_map_ns_ = now_ns;
}

void RosStage::take_statuses() {
  for (const zenoh::Sample& sample : statuses_.take()) {
    const runtime::Read<msg::Status> status(Key::kStatus, sample);
    if (!status) continue;
    if (heard_.size() >= kNewestStatuses && !heard_.contains(sample.key)) continue;
    heard_[sample.key] = {diagnostic_of(*status), runtime::steady_ns()};
  }
}

Diagnostic RosStage::of_pose() const {
  Diagnostic d;
  d.name = "zenoh-loam: pose";
  d.hardware = stage_.identity().robot;
  d.message = msg::EnumNameHealth(to_message(health_));
  if (last_pose_ns_ == 0 || runtime::steady_ns() - last_pose_ns_ > kSilent_ns) {
    d.level = DiagnosticLevel::kStale;
    d.message = "no pose comes";
  } else if (!is_placed(health_)) {
    d.level = DiagnosticLevel::kError;
    d.message += ": the pose in the map is not known, and is not published";
  } else if (health_ != Health::kOk) {
    d.level = DiagnosticLevel::kWarning;
  }
  return d;
}

void RosStage::say_diagnostics() {
  take_statuses();
  DiagnosticsMessage out;
  out.header = {stage_.now_ns(), {}};
  out.all.push_back(of_pose());
  for (auto it = heard_.begin(); it != heard_.end();) {
    const std::int64_t silent_ns = runtime::steady_ns() - it->second.stamp_ns;
    if (silent_ns > 2 * kPatience_ns) {
      it = heard_.erase(it);
      continue;
    }
    Diagnostic d = it->second.diagnostic;
    if (silent_ns > kSilent_ns) {
      d.level = DiagnosticLevel::kStale;
      d.message = "silent for " + std::to_string(silent_ns / 1'000'000'000) + " s";
    }
    out.all.push_back(std::move(d));
    ++it;
  }
  diagnostics_->put(encode(out), out.header.stamp_ns, replay_);
}

void RosStage::take_imu() {
  std::vector<msg::ImuSample> samples;
  std::size_t unread = 0;
  for (const zenoh::Sample& sample : readings_.take()) {
    const zenoh::AlignedBytes bytes = zenoh::view_aligned(sample.payload);
    if (const auto reading = decode_imu(bytes.data())) {
      samples.push_back(to_message(*reading));
    } else {
      ++unread;
    }
  }
  unread_imu_.add(unread, runtime::steady_ns());
  const std::uint64_t shown = unread_imu_.shown(runtime::steady_ns());
  stage_.degraded("imu", shown == 0 ? std::string()
                                    : std::to_string(shown) + " messages of " + config_.imu_topic +
                                          " hold no acceleration and rate, or can't be read");
  if (samples.empty()) return;
  const std::int64_t now_ns = stage_.now_ns();
  HeaderFields header = imu_->header(now_ns, now_ns);
  header.frame = "imu";
  header.stamp_ns = samples.front().stamp_ns();
  imu_->publish(header, build_imu(header, samples, msg::ClockSource::Unknown));
}

void RosStage::take_places() {
  for (const zenoh::Sample& sample : places_.take()) {
    const zenoh::AlignedBytes bytes = zenoh::view_aligned(sample.payload);
    if (const auto said = decode_place(bytes.data())) {
      place(*said);
    } else {
      refusal_.say("a message of " + topic("initialpose") + " can't be read", runtime::steady_ns());
    }
  }
  if (const auto answers = placing_.take()) {
    const std::string refusal = refusal_of(*answers);
    refusal_.say(refusal, runtime::steady_ns());
    if (refusal.empty()) runtime::log_info("mapping took the initial pose");
  }
  stage_.degraded("initialpose", refusal_.shown(runtime::steady_ns()));
}

std::string RosStage::refusal_of(const std::vector<zenoh::Sample>& answers) const {
  if (answers.empty()) {
    return "mapping did not answer to " + topic("initialpose") + ": is it there?";
  }
  const runtime::Read<msg::CommandReply> reply(Key::kCommand, answers.front());
  if (!reply) return "mapping's answer to " + topic("initialpose") + " can't be read";
  if (reply->ok()) return {};
  return "mapping refused " + topic("initialpose") + ": " +
         (reply->message() == nullptr ? "without a reason" : reply->message()->str());
}

void RosStage::place(const PlaceMessage& said) {
  if (said.frame != frame("map")) {
    refusal_.say("a pose of " + topic("initialpose") + " is in the frame '" + said.frame + "'; '" +
                     frame("map") + "' is expected",
                 runtime::steady_ns());
    return;
  }
  const nlohmann::json arguments = {
      {"x_m", said.x_m}, {"y_m", said.y_m}, {"yaw_deg", said.yaw_rad * 180.0 / std::numbers::pi}};
  placing_.start(stage_.session(), stage_.keys().command("mapping", "place"), kPlacedWithin, bell_,
                 zenoh::Bytes::copy_of(arguments.dump()));
}

void RosStage::look_for_nodes() {
  const std::size_t others = node_.others();
  stage_.figure("ros_nodes", static_cast<double>(others));
  const bool alone = others == 0 && runtime::steady_ns() - began_ns_ > kPatience_ns;
  stage_.degraded("ros", alone ? no_node_text(config_) : std::string());
}

}  // namespace zloam::ros
