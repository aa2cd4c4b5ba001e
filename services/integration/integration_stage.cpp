#include "integration/integration_stage.hpp"

#include <array>
#include <cstdio>
#include <nlohmann/json.hpp>
#include <tuple>

#include "common/geometry/atomic_file.hpp"
#include "common/runtime/recall.hpp"

namespace zloam::integration {
namespace {

constexpr std::array kNames = {"trajectory.tum", "trajectory.kitti", "odometry.tum"};

// Plausible change of a correction: after a gap mapping searches within a few metres.
constexpr MotionReach kCorrectionReach{.m = 25.0, .m_per_s = 0.0, .rad = 1.0, .rad_per_s = 0.0};

// These fields have the same names in Odometry and MapCorrection.
template <typename Table>
Weak weak_of(const Table& table) {
  return {table.degenerate(), vector_of(table.weak_translation()), vector_of(table.weak_rotation()),
          table.weak_sigma_measured(), table.weak_sigma_predicted()};
}

}  // namespace

void bind(runtime::Parameters& p, IntegrationConfig& c) {
  // Mapping's own key: the two must never disagree, or a replay would wait for ever.
  p.add("mapping.every", &c.mapping_every, {1, 1000}, "",
        "map every n-th sweep by number, and the last one; slices are all mapped");
  p.add("integration.correction_delay", &c.correction_delay, {0, 1000}, "",
        "replay: minimum age of a pose's correction, in sweeps");
  p.add("integration.jump_m", &c.jump_m, {0.0, 100.0}, "m",
        "minimum motion of a correction that is marked as a jump");
  p.add("integration.jump_rad", &c.jump_rad, {0.0, 3.15}, "rad",
        "minimum rotation of a correction that is marked as a jump");
  p.add("integration.drift_limit", &c.drift_limit, {1e-6, 1.0}, "",
        "health is Degenerate if the pose's sigma along a direction is above this share of 10 m");
  p.add("integration.output_dir", &c.output_dir,
        "folder of trajectory.tum, trajectory.kitti and odometry.tum (further runs: "
        "trajectory_2.tum and so on); empty: no files",
        runtime::Effect::kNone);
}

IntegrationStage::IntegrationStage(runtime::Stage& stage, const IntegrationConfig& config)
    : stage_(stage),
      config_(config),
      integrator_(config),
      pose_(stage.outlet(Key::kPose)),
      ack_(stage.flow_ack("integration")),
      correction_check_(kCorrectionReach),
      journal_(config.output_dir.empty() ? "" : config.output_dir + "/trajectory.journal"),
      state_(config.output_dir.empty() ? "" : config.output_dir + "/trajectory.state"),
      files_(config.output_dir, ".zloam-trajectory-runs") {
  runtime::InletOptions odometry;
  odometry.sweeps = runtime::SweepSet::kPublisherDecides;
  odometry.lossless = true;
  odometry.keep = static_cast<std::size_t>(stage.shared().recovery.keep_messages);
  // The run ends with the last pose, which may still wait for its correction.
  odometry.ends_run = false;
  odometry.implausible = [this](const runtime::Message& m) {
    return implausible(OdometryMessage(m));
  };
  inlet_ = &stage.inlet<msg::Odometry>(
      Key::kOdometry, odometry, [this](const OdometryMessage& message) { return take(message); });
  runtime::InletOptions corrections;
  corrections.sweeps = runtime::SweepSet::kPublisherDecides;
  // mapping.every
  corrections.sparse = true;
  corrections.lossless = true;
  corrections.keep = odometry.keep;
  corrections.ends_run = false;
  corrections.implausible = [this](const runtime::Message& m) {
    return implausible(CorrectionMessage(m));
  };
  stage.inlet<msg::MapCorrection>(Key::kMapCorrection, corrections,
                                  [this](const CorrectionMessage& message) { take(message); });
  // {"path": "..."} for a folder below integration.output_dir.
  stage.command("save", [this](const std::string& arguments) { return save(arguments); });
  stage.on_new_run([this](const msg::Header& first) { new_run(first); });
  stage.on_end_of_run([this](std::uint64_t) {
    if (!write_files().empty()) return;
    journal_.remove();
    state_.remove();
    // Nothing needs them any more.
    for (const char* topic : {"journal", "state file"}) stage_.degraded(topic, "");
  });
  stage.on_stop([this] {
    if (!unsaved_) return;
    if (const std::string error = write_files(); !error.empty()) throw runtime::IoError(error);
  });
}

void IntegrationStage::new_run(const msg::Header& first) {
  const bool was_in_run = std::exchange(in_run_, true);
  next_sweep_ = 0;
  waiting_.clear();
  odometry_check_.reset();
  correction_check_.reset();
  if (was_in_run && runtime::goes_on(first, last_instant_ns_, runtime::kLongestSearch_ns)) {
    integrator_.new_run();
    runtime::report(stage_, {1, 0, first.stamp_ns() - last_instant_ns_});
    return;
  }
  if (unsaved_) keep_unwritten(write_files());
  integrator_.reset();
  trajectory_.clear();
  odometry_.clear();
  // What could not be written is in the journal that was kept.
  unsaved_ = false;
  run_ = {first.run(), first.replay(), 0};
  if (was_in_run) {
    begin_journal({});
  } else {
    restart(first);
  }
}

/// What the run's files lack is in its journal, which the next run would replace.
void IntegrationStage::keep_unwritten(const std::string& error) {
  if (error.empty()) return;
  const std::string kept = journal_.keep_unwritten();
  const std::string poses =
      journal_.is_behind() ? "its first poses, for which there was room," : "its poses";
  stage_.lost_output(kept.empty() ? error
                                  : error + "; " + poses + " are kept in " + kept +
                                        ": make room, stop integration and rename it to "
                                        "trajectory.journal; the next start writes them");
}

void IntegrationStage::begin_journal(const std::vector<JournalPose>& poses) {
  stage_.degraded("journal", journal_.begin(poses));
  stage_.degraded("state file", state_.begin());
}

/// Reports an error until the journal has its poses.
void IntegrationStage::append(const JournalPose& pose) {
  const bool was_behind = journal_.is_behind();
  const std::string error = journal_.append(pose);
  const bool caught_up = was_behind && !journal_.is_behind();
  if (caught_up || !error.empty()) stage_.degraded("journal", error);
}

std::string IntegrationStage::implausible(const OdometryMessage& message) {
  const Pose pose = pose_of(message->pose_odom_base());
  std::string why =
      odometry_check_.check(message.header().odom_epoch(), message->instant_ns(), pose);
  if (why.empty()) T_odom_base_ = pose;
  return why;
}

std::string IntegrationStage::implausible(const CorrectionMessage& message) {
  // A correction moves the pose at once, whatever time has passed since the last one.
  return correction_check_.check(message.header().odom_epoch(), 0,
                                 pose_of(message->pose_map_odom()), T_odom_base_);
}

runtime::Outcome IntegrationStage::take(const OdometryMessage& message) {
  // Already published, by the previous instance or by catch_up().
  if (message.sweep() < next_sweep_) return runtime::Outcome::kNotMine;
  process(message);
  return runtime::Outcome::kProcessed;
}

void IntegrationStage::process(const OdometryMessage& message) {
  next_sweep_ = message.sweep() + 1;
  OdometryPose pose;
  pose.sweep = message.sweep();
  pose.instant_ns = message->instant_ns();
  pose.odom_epoch = message.header().odom_epoch();
  pose.T_odom_base = pose_of(message->pose_odom_base());
  pose.twist_per_s = twist_of(message->twist());
  pose.step_covariance = covariance_of(message->covariance());
  pose.health = health_of(message->health());
  pose.weak = weak_of(*message);
  pose.replay = message.replay();
  odometry_.push_back({pose.instant_ns, pose.T_odom_base});
  waiting_.emplace(pose.sweep, message.raw());
  publish(integrator_.add(pose), message.raw().started_ns);
  // A replay's pose waits for its correction.
  if (waiting_.contains(pose.sweep)) ack_.waits(message.run());
}

void IntegrationStage::take(const CorrectionMessage& message) {
  Correction correction;
  correction.sweep = message.sweep();
  correction.map_id = message.header().map_id();
  correction.odom_epoch = message.header().odom_epoch();
  correction.T_map_odom = pose_of(message->pose_map_odom());
  correction.covariance = covariance_of(message->covariance());
  correction.health = health_of(message->health());
  correction.weak = weak_of(*message);
  publish(integrator_.add(correction), message.raw().started_ns);
}

void IntegrationStage::publish(const std::vector<FusedPose>& poses, std::int64_t started_ns) {
  for (const FusedPose& pose : poses) {
    const auto cause = waiting_.find(pose.sweep);
    if (cause == waiting_.end()) continue;
    runtime::Message message = cause->second;
    // The work on a pose that waited for its correction starts when the correction arrives.
    message.started_ns = started_ns;
    waiting_.erase(cause);
    publish(pose, message);
  }
  stage_.figure("waiting_poses", static_cast<double>(integrator_.waiting()));
}

void IntegrationStage::publish(const FusedPose& fused, const runtime::Message& cause) {
  MapPoseFields fields;
  fields.instant_ns = fused.instant_ns;
  fields.T_map_base = fused.T_map_base;
  fields.twist_per_s = fused.twist_per_s;
  fields.covariance = fused.covariance;
  fields.correction_sweep = fused.correction_sweep;
  fields.has_correction = fused.has_correction;
  fields.jump = fused.jump;
  fields.health = fused.health;
  fields.weak = {fused.weak.degenerate, fused.weak.translation, fused.weak.rotation,
                 fused.weak.sigma_measured, fused.weak.sigma_predicted};
  HeaderFields header = pose_.header(cause);
  header.frame = "map";
  pose_.publish(header, build(header, fields));
  trajectory_.push_back({fused.instant_ns, fused.T_map_base});
  last_instant_ns_ = fused.instant_ns;
  unsaved_ = true;
  // Written before the journal: if this process is killed in between, the other file still has the
  // state of the journal's last pose. Of poses released together only the last one has a state.
  if (integrator_.last_sweep() == fused.sweep) {
    stage_.degraded("state file", state_.write({header.run, fused.sweep, integrator_.state()}));
  }
  // Written after publishing: if this process is killed in between, the next instance publishes the
  // pose again, and readers drop the copy. Written before the acknowledgement, because acknowledged
  // sweeps are not requested again.
  append({header.run, fused.sweep, fused.instant_ns, header.odom_epoch, fused.T_map_base,
          pose_of(message_of<msg::Odometry>(cause.bytes).pose_odom_base()), header.replay});
  if (header.last_packet_ns > 0) {
    stage_.latency("end_to_end",
                   1e-6 * static_cast<double>(stage_.now_ns() - header.last_packet_ns));
  }
  say_drift(fused);
  if (fused.jump) {
    runtime::log_warning("the correction moved the pose", {{"sweep", fused.sweep}});
  }
  // Files before the acknowledgement, because its receivers may look for them.
  if (header.end_of_run) stage_.end_of_run(header.run);
  ack_.done_below(header.run, header.sweep + 1);
}

void IntegrationStage::say_drift(const FusedPose& fused) {
  stage_.figure("odometry_drift_m", fused.odometry_drift_m);
  if (!fused.odometry_drifts) return stage_.degraded("odometry", "");
  std::array<char, 64> figures{};
  std::snprintf(figures.data(), figures.size(), "%.2f m over the last %.1f m",
                fused.odometry_drift_m, fused.odometry_way_m);
  stage_.degraded("odometry",
                  "odometry and map differ by " + std::string(figures.data()) +
                      ", one of them is wrong: exclude what moves with the sensor, as parts of its "
                      "platform (driver.azimuth_mask_deg, driver.body_box_*)");
}

std::string IntegrationStage::write_to(
    const std::function<std::string(const std::string&)>& path_of,
    const runtime::OutputFiles::Run& run, const Trajectory& trajectory,
    const Trajectory& odometry) {
  const std::tuple<const char*, TrajectoryText::Line, const Trajectory&> files[] = {
      {kNames[0], tum_line, trajectory},
      {kNames[1], kitti_line, trajectory},
      {kNames[2], tum_line, odometry},
  };
  for (const auto& [name, line, poses] : files) {
    TrajectoryText text(poses, line);
    std::string error = write_file_atomically(path_of(name), [&] { return text.next(); });
    if (error.empty()) error = files_.made(path_of(name), run);
    if (!error.empty()) return error;
  }
  return {};
}

std::string IntegrationStage::write_run(const runtime::OutputFiles::Run& run,
                                        const Trajectory& trajectory, const Trajectory& odometry) {
  const std::string suffix = files_.suffix(run, {kNames.begin(), kNames.end()});
  const auto path_of = [&](const std::string& name) { return files_.path(name, suffix); };
  std::string error = write_to(path_of, run, trajectory, odometry);
  stage_.degraded("trajectory", error);
  if (!error.empty()) {
    runtime::log_error("trajectory not written", {{"reason", error}});
    return error;
  }
  runtime::log_info("trajectory written",
                    {{"file", path_of(kNames[0])}, {"poses", trajectory.size()}});
  return {};
}

std::string IntegrationStage::write_files() {
  if (config_.output_dir.empty()) return {};
  run_.count = trajectory_.size();
  std::string error = write_run(run_, trajectory_, odometry_);
  if (error.empty()) unsaved_ = false;
  return error;
}

runtime::CommandReply IntegrationStage::save(const std::string& arguments_json) {
  const auto arguments = nlohmann::json::parse(arguments_json.empty() ? "{}" : arguments_json);
  const auto [folder, refusal] = files_.place(arguments.value("path", "."));
  if (!refusal.empty()) return {false, refusal, "{}"};
  run_.count = trajectory_.size();
  // Renamed in the capture, because clang 14 cannot capture structured bindings.
  const auto path_of = [&place = folder](const std::string& name) { return place + "/" + name; };
  std::string error;
  if (!arguments.contains("path")) {
    error = write_files();
  } else {
    for (const char* name : kNames) {
      if (error.empty()) error = files_.in_the_way(path_of(name));
    }
    if (error.empty()) error = write_to(path_of, run_, trajectory_, odometry_);
  }
  if (!error.empty()) return {false, error, "{}"};
  const nlohmann::json results = {{"path", folder}, {"poses", trajectory_.size()}};
  return {true, "trajectories written to " + folder, results.dump()};
}

}  // namespace zloam::integration
