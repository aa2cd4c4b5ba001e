#include "odometry/odometry_stage.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <string>
#include <string_view>
#include <utility>

#include "common/runtime/recall.hpp"
#include "common/runtime/replicas.hpp"
#include "odometry/published_health.hpp"

namespace zloam::odometry {
namespace {

// Replicas of registration learn from the progress which sweeps are still to be processed.
constexpr std::chrono::milliseconds kProgressPeriod{50};

// Number of wrong IMU predictions after which the status reports them.
constexpr std::uint32_t kSuspicious = 3;

// Delay of the IMU's stamps above which the user is told; smaller ones are compensated silently, in
// a live run too.
constexpr double kLate_s = 0.01;

// Successive sweeps without an IMU after which it is reported, as in the driver.
constexpr std::uint32_t kUncovered = 10;

const std::string kNotCovering =
    "IMU readings come, but do not cover the sweeps and are not used: at least three for each "
    "sweep are needed, and no gap longer than three of their periods. Check the sensor's rate "
    "and its stamps: do several readings have almost the same one?";

const std::string kInconsistent =
    "IMU inconsistent with the lidar motion; ignoring it. Check mounting.imu_rpy_deg, units and "
    "driver.imu_delay_ms";

std::string doubts_about(const InertialState& imu) {
  if (imu.contradictions >= kSuspicious) {
    return kInconsistent;
  }
  const double delay_s = imu.errors().delay_s;
  if (std::abs(delay_s) - 3.0 * imu.delay_sigma_s() < kLate_s) return {};
  return "the inertial sensor's stamps are " + std::to_string(std::lround(1e3 * delay_s)) +
         " ms late, as its turns and the points' tell; that is allowed for, but a live sweep waits "
         "for its readings by the stamps: add it to driver.imu_delay_ms";
}

void append(std::vector<MapPoint>& out, PointSpan points) {
  for (const Point& p : points) out.push_back({p.x, p.y, p.z, p.intensity});
}

}  // namespace

OdometryStage::OdometryStage(runtime::Stage& stage, const OdometryConfig& config)
    : stage_(stage),
      config_(config),
      odometry_(config, stage.shared().mounting.T_base_lidar(),
                stage.shared().mounting.T_base_imu()),
      T_base_lidar_(stage.shared().mounting.T_base_lidar()),
      pose_(stage.outlet(Key::kOdometry)),
      features_(stage.outlet(Key::kOdometryFeatures)),
      sweep_(stage.outlet(Key::kOdometrySweep)),
      progress_(stage.outlet(Key::kProgress)) {
  runtime::InletOptions options = runtime::from_replicas(stage, "registration");
  options.on_given_up = [this](std::uint64_t, std::uint64_t sweep, std::string_view) {
    // A sweep that was already caught up with after a restart may be dropped here once more.
    next_sweep_ = std::max(next_sweep_, sweep + 1);
  };
  inlet_ = &stage.inlet<msg::Features>(Key::kFeatures, options,
                                       [this](const Features& features) { return take(features); });
  stage.answer(stage.keys().of(Key::kPathOdometry),
               [this](runtime::Answer& answer) { answer_path(answer); });
  // Forgets the motion; the next sweep begins a new odom frame.
  stage.command("reset", [this](const std::string&) { return reset(); });
  stage.on_new_run([this](const msg::Header& first) { new_run(first); });
  stage.every(kProgressPeriod, [this] {
    if (!path_.empty()) publish_progress(progress_.header(stage_.now_ns(), stage_.now_ns()));
  });
}

void OdometryStage::new_run(const msg::Header& first) {
  const bool was_in_run = std::exchange(in_run_, true);
  next_sweep_ = 0;
  done_below_ = 0;
  if (was_in_run && runtime::goes_on(first, last_instant_ns_)) {
    runtime::report(stage_, {1, 0, first.stamp_ns() - last_instant_ns_});
    return;
  }
  odometry_.reset();
  path_.clear();
  frame_sweeps_ = 0;
  // In a replay everything, the epoch too, is a function of the capture.
  odom_epoch_ = was_in_run && !first.replay() ? odom_epoch_ + 1 : 0;
  if (!was_in_run && !(first.replay() && first.sweep() == 0)) restart(first);
}

runtime::Outcome OdometryStage::take(const Features& features) {
  if (stood_still_before(features)) catch_up(features.header(), last_instant_ns_);
  // Already processed, by the previous instance or by catch_up().
  if (features.sweep() < next_sweep_) return runtime::Outcome::kNotMine;
  process(features);
  return runtime::Outcome::kProcessed;
}

FeatureSweep OdometryStage::input_of(const Features& features) {
  FeatureSweep input;
  input.sweep = features.sweep();
  input.stamp_ns = features.header().stamp_ns();
  input.period_ns = features->period_ns();
  input.deskewed = features->deskewed();
  input.slices = std::max<std::uint16_t>(1, features->slices());
  input.range_noise_m = static_cast<double>(features->range_noise_m());
  input.less_sharp = points_of(features->less_sharp());
  input.less_flat = points_of(features->less_flat());
  readings_ = imu_of(features->imu());
  input.imu = readings_;
  return input;
}

OdometryResult OdometryStage::locate(const Features& features, const FeatureSweep& input) {
  if (stage_.configure_for(features)) odometry_.configure(config_);
  OdometryResult result = odometry_.locate(input);
  if (result.new_frame) {
    count_frame();
    runtime::log_warning("a new odom frame begins: the slices could not be followed",
                         {{"odom_epoch", odom_epoch_}, {"sweep", features.sweep()}});
  }
  publish_pose(features, result);
  return result;
}

void OdometryStage::process(const Features& features) {
  done_below_ = features.sweep() + 1;
  next_sweep_ = std::max(next_sweep_, done_below_);
  // Registration dropped this sweep and reports it: no pose, and the next sweep bridges the gap.
  if (health_of(features->health()) == Health::kDropped) return;
  if (is_too_far(features)) break_frame(features.sweep());
  const FeatureSweep input = input_of(features);
  OdometryResult result = locate(features, input);
  last_instant_ns_ = result.instant_ns;
  odometry_.complete(input, result);
  publish_features(features, result);
  if (sweep_.matching()) publish_sweep(features, result);
  path_.emplace_back(result.instant_ns, result.sweep, to_message(result.T_odom_base));
  ++frame_sweeps_;
  publish_progress(progress_.header(features));
  note_figures(result);
}

void OdometryStage::publish_pose(const Features& features, const OdometryResult& result) {
  const Degeneracy& d = result.degeneracy;
  OdometryFields fields;
  fields.instant_ns = result.instant_ns;
  fields.T_odom_base = result.T_odom_base;
  fields.twist_per_s = result.twist_per_s;
  fields.covariance = result.covariance;
  fields.weak = {d.degenerate, d.weak_translation, d.weak_rotation, d.sigma_measured,
                 d.sigma_predicted};
  fields.solve = {result.diagnostics.iterations, result.diagnostics.planes,
                  result.diagnostics.residual_m};
  fields.health = published_health(result.health, health_of(features->health()));
  fields.prev_sweep = result.prev_sweep;
  HeaderFields header = pose_.header(features);
  header.frame = "odom";
  header.odom_epoch = odom_epoch_;
  pose_.publish(header, build(header, fields));
  last_header_ = header;
}

void OdometryStage::publish_features(const Features& features, const OdometryResult& result) {
  OdometryFeaturesFields fields;
  fields.instant_ns = result.instant_ns;
  fields.T_odom_base = result.T_odom_base;
  fields.twist_per_s = result.twist_per_s;
  fields.covariance = result.covariance;
  fields.period_ns = features->period_ns();
  fields.T_base_lidar = T_base_lidar_;
  fields.edges = result.edges;
  fields.planes = result.planes;
  fields.prev_sweep = result.prev_sweep;
  fields.health = published_health(result.health, health_of(features->health()));
  fields.degenerate = result.degeneracy.degenerate;
  fields.range_noise_m = features->range_noise_m();
  fields.state_covariance = result.state_covariance;
  fields.inertial = result.inertial_step;
  fields.fit = result.fit;
  fields.slices = features->slices();
  std::vector<double> inertial_state;
  if (result.inertia) inertial_state = packed(*result.inertia);
  fields.inertial_state = inertial_state;
  fields.state = result.slice_state;
  HeaderFields header = features_.header(features);
  header.frame = "base_link";
  header.odom_epoch = odom_epoch_;
  features_.publish(header, build(header, fields));
}

// Publishes the deskewed sweep with all returns that registration did not reject.
void OdometryStage::publish_sweep(const Features& features, const OdometryResult& result) {
  std::vector<MapPoint> points;
  points.reserve(result.edges.size() + result.planes.size());
  append(points, result.edges);
  append(points, result.planes);
  CloudFields fields;
  fields.instant_ns = result.instant_ns;
  fields.points = points;
  HeaderFields header = sweep_.header(features);
  header.frame = "base_link";
  header.odom_epoch = odom_epoch_;
  sweep_.publish(header, build(header, fields));
}

void OdometryStage::publish_progress(HeaderFields header) {
  runtime::publish_progress(stage_, progress_, *inlet_, std::move(header), last_header_.run,
                            next_sweep_);
}

void OdometryStage::note_figures(const OdometryResult& result) {
  stage_.figure("iterations", result.diagnostics.iterations);
  stage_.figure("correspondences", result.diagnostics.planes);
  stage_.figure("residual_m", result.diagnostics.residual_m);
  stage_.figure("prediction_error_m", result.diagnostics.prediction_error_m);
  stage_.figure("degenerate", result.degeneracy.degenerate ? 1.0 : 0.0);
  note_imu(result);
}

void OdometryStage::note_imu(const OdometryResult& result) {
  // A slow sensor leaves single sweeps without readings. That none come any more is the driver's to
  // report.
  silent_in_row_ = readings_.empty() ? silent_in_row_ + 1 : 0;
  if (silent_in_row_ == 0) ++uncovered_in_row_;
  if (silent_in_row_ >= kUncovered || result.diagnostics.imu_covers) uncovered_in_row_ = 0;
  stage_.degraded("imu", doubts_about_imu(result));
  imu_came_ = imu_came_ || !readings_.empty();
  if (!imu_came_) return;
  // Also when its readings have ended: else the figure would tell of the last sweep with some.
  stage_.figure("imu_used", result.diagnostics.imu_used ? 1.0 : 0.0);
  if (!result.inertia) return;
  const InertialState& known = *result.inertia;
  const ImuErrors errors = known.errors();
  stage_.figure("imu_force_bias_mps2", errors.force_mps2.norm());
  stage_.figure("imu_rate_bias_radps", errors.rate_radps.norm());
  stage_.figure("imu_delay_ms", 1e3 * errors.delay_s);
  stage_.figure("imu_contradictions", known.contradictions);
}

std::string OdometryStage::doubts_about_imu(const OdometryResult& result) const {
  // An IMU whose readings have ended is ignored in any case.
  if (silent_in_row_ >= kUncovered) return {};
  // Slices have no filter state, and an IMU that they ignore once is ignored for good.
  const bool ignored = !result.inertia && result.diagnostics.imu_contradictions > 1;
  if (ignored) return kInconsistent;
  if (config_.use_imu && uncovered_in_row_ >= kUncovered) return kNotCovering;
  return result.inertia ? doubts_about(*result.inertia) : std::string();
}

void OdometryStage::answer_path(runtime::Answer& answer) const {
  answer.reply(stage_.keys().of(Key::kPathOdometry), encoding_of(Key::kPathOdometry),
               build_path(last_header_, path_));
}

void OdometryStage::next_frame() {
  odometry_.reset();
  count_frame();
}

void OdometryStage::count_frame() {
  ++odom_epoch_;
  frame_sweeps_ = 0;
}

runtime::CommandReply OdometryStage::reset() {
  next_frame();
  return {true, "a new odom frame begins with the next sweep",
          "{\"odom_epoch\": " + std::to_string(odom_epoch_) + "}"};
}

}  // namespace zloam::odometry
