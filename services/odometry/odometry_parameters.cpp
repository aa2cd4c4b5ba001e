#include "odometry/odometry_parameters.hpp"

#include "common/runtime/parameters.hpp"

namespace zloam::odometry {
namespace {

void bind_solver(runtime::Parameters& p, OdometryConfig& c) {
  p.add("odometry.max_iterations", &c.max_iterations, {1, 100}, "", "of matching and solving")
      .live();
  p.add("odometry.stop_translation_m", &c.stop_translation_m, {0.0, 1.0}, "m",
        "a step below this, and below stop_rotation_rad, ends the iteration")
      .live();
  p.add("odometry.stop_rotation_rad", &c.stop_rotation_rad, {0.0, 1.0}, "rad",
        "a step below this, and below stop_translation_m, ends the iteration")
      .live();
  p.add("odometry.min_correspondences", &c.min_correspondences, {1, 1e6}, "points",
        "with fewer matched points the pose is the prediction")
      .live();
  p.add("odometry.kernel_m", &c.kernel_m, {0.001, 100.0}, "m",
        "width of the robust kernel at the end of the iteration")
      .live();
  p.add("odometry.kernel_start_m", &c.kernel_start_m, {0.001, 100.0}, "m",
        "width of the robust kernel at its start")
      .live();
  p.add("odometry.correlation", &c.correlation, {1.0, 1e4}, "",
        "information is divided by this, as residuals on one surface are correlated")
      .live();
}

void bind_prior(runtime::Parameters& p, OdometryConfig& c) {
  p.add("odometry.begin_sigma_m", &c.begin_sigma_m, {1e-6, 10.0}, "m",
        "how far the end of the sweep before is off where nothing else is known")
      .live();
  p.add("odometry.begin_sigma_rad", &c.begin_sigma_rad, {1e-6, 10.0}, "rad",
        "how far the end of the sweep before is off where nothing else is known")
      .live();
  p.add("odometry.pose_sigma_m", &c.pose_sigma_m, {1e-6, 10.0}, "m",
        "how far the middle of a sweep is taken to be off at most")
      .live();
  p.add("odometry.pose_sigma_rad", &c.pose_sigma_rad, {1e-6, 10.0}, "rad",
        "how far the middle of a sweep is taken to be off at most")
      .live();
  p.add("odometry.continuity_sigma_m", &c.continuity_sigma_m, {1e-6, 10.0}, "m",
        "what a sweep's begin may differ by from the end of the one before")
      .live();
  p.add("odometry.continuity_sigma_rad", &c.continuity_sigma_rad, {1e-6, 10.0}, "rad",
        "what a sweep's begin may differ by from the end of the one before")
      .live();
  p.add("odometry.continuity_share", &c.continuity_share, {0.0, 10.0}, "",
        "and by this share of what the last two twists differ by")
      .live();
  p.add("odometry.acceleration_sigma_mps2", &c.acceleration_sigma_mps2, {1e-3, 1e3}, "m/s^2",
        "how fast the speed usually changes")
      .live();
  p.add("odometry.angular_acceleration_sigma_radps2", &c.angular_acceleration_sigma_radps2,
        {1e-3, 1e3}, "rad/s^2", "how fast the rate of turn usually changes")
      .live();
  p.add("odometry.max_turn_radps", &c.max_turn_radps, {0.1, 1e3}, "rad/s",
        "no platform turns faster: what was found so is not believed")
      .live();
  p.add("odometry.initial_speed_sigma_mps", &c.initial_speed_sigma_mps, {1e-3, 1e3}, "m/s",
        "speed of the first sweep, about rest")
      .live();
  p.add("odometry.initial_rate_sigma_radps", &c.initial_rate_sigma_radps, {1e-3, 1e3}, "rad/s",
        "rate of turn of the first sweep, about rest")
      .live();
}

void bind_imu_trust(runtime::Parameters& p, OdometryConfig& c) {
  p.add("odometry.use_imu", &c.use_imu,
        "inertial readings that come with the sweeps foretell the motion");
  p.add("odometry.imu_force_noise", &c.imu_force_noise, {1e-6, 10.0}, "m/s^2/sqrt(Hz)",
        "white noise of the accelerometer");
  p.add("odometry.imu_rate_noise", &c.imu_rate_noise, {1e-7, 1.0}, "rad/s/sqrt(Hz)",
        "white noise of the gyroscope");
  p.add("odometry.imu_force_error_mps2", &c.imu_force_error_mps2, {0.0, 10.0}, "m/s^2",
        "what else a sweep's mean force is off by");
  p.add("odometry.imu_scale_error", &c.imu_scale_error, {0.0, 1.0}, "",
        "what a turn is off by, as a share of it");
  p.add("odometry.imu_force_bias_mps2", &c.imu_force_bias_mps2, {0.0, 10.0}, "m/s^2",
        "bias of the accelerometer at the start");
  p.add("odometry.imu_rate_bias_radps", &c.imu_rate_bias_radps, {0.0, 1.0}, "rad/s",
        "bias of the gyroscope at the start; below three times this the platform may be at rest");
}

void bind_imu_drift(runtime::Parameters& p, OdometryConfig& c) {
  p.add("odometry.imu_force_walk", &c.imu_force_walk, {0.0, 10.0}, "m/s^2/sqrt(s)",
        "what the accelerometer's bias wanders by");
  p.add("odometry.imu_rate_walk", &c.imu_rate_walk, {0.0, 1.0}, "rad/s/sqrt(s)",
        "what the gyroscope's bias wanders by");
  p.add("odometry.imu_gravity_walk", &c.imu_gravity_walk, {0.0, 10.0}, "m/s^2/sqrt(s)",
        "what gravity wanders by in the odom frame, as that tilts");
  p.add("odometry.imu_delay_sigma_ms", &c.imu_delay_sigma_ms, {0.0, 1e3}, "ms",
        "by how much the stamps may be late or early at the start; 0, and no walk: not at all");
  p.add("odometry.imu_delay_walk_ms", &c.imu_delay_walk_ms, {0.0, 1e3}, "ms/sqrt(s)",
        "what their delay wanders by");
  p.add("odometry.imu_normal_error_rad", &c.imu_normal_error_rad, {0.0, 1.0}, "rad",
        "error of normals: what it may pretend to along the direction held least is left to the "
        "inertial sensor");
  p.add("odometry.imu_start_acceleration_mps2", &c.imu_start_acceleration_mps2, {1e-6, 100.0},
        "m/s^2", "of the platform in its first sweep when it moves");
  p.add("odometry.imu_rest_acceleration_mps2", &c.imu_rest_acceleration_mps2, {1e-6, 100.0},
        "m/s^2", "the same when it seems to be at rest");
}

void bind_targets(runtime::Parameters& p, OdometryConfig& c) {
  p.add("odometry.window_sweeps", &c.window_sweeps, {1, 1000}, "sweeps", "kept in the target");
  p.add("odometry.voxel_m", &c.voxel_m, {0.05, 50.0}, "m", "edge of the coarsest voxels");
  p.add("odometry.voxel_levels", &c.voxel_levels, {1, 5}, "", "each halves the edge");
  p.add("odometry.max_matched_points", &c.max_matched_points, {10, 1e7}, "points",
        "of a sweep, evenly chosen")
      .live();
  p.add("odometry.enough_inserted_points", &c.enough_inserted_points, {10, 1e7}, "points",
        "a denser sweep is thinned to no fewer");
  p.add("odometry.plane_min_points", &c.plane_min_points, {3, 1e6}, "points", "of a plane");
  p.add("odometry.plane_thickness_sigmas", &c.plane_thickness_sigmas, {0.1, 100.0}, "",
        "a plane is thinner than this many range noises");
  p.add("odometry.plane_width_sigmas", &c.plane_width_sigmas, {0.0, 100.0}, "",
        "a plane is wider than this many range noises");
  p.add("odometry.plane_normal_error_rad", &c.plane_normal_error_rad, {1e-4, 1.0}, "rad",
        "largest standard deviation of a plane's normal");
}

void bind_result(runtime::Parameters& p, OdometryConfig& c) {
  p.add(
       "odometry.drift_limit", &c.drift_limit, {1e-6, 1.0}, "",
       "degenerate: the points leave a direction open by more than this share of 10 m, or of 1 rad")
      .live();
  p.add("odometry.covariance_scale", &c.covariance_scale, {1e-6, 1e6}, "",
        "factor on the published covariance, from comparison with ground truth")
      .live();
  p.add("odometry.restart_after", &c.restart_after, {1, 1e6}, "sweeps",
        "with points and no match, after which the target is founded anew");
}

}  // namespace

void bind(runtime::Parameters& p, OdometryConfig& c) {
  bind_solver(p, c);
  bind_prior(p, c);
  bind_imu_trust(p, c);
  bind_imu_drift(p, c);
  bind_targets(p, c);
  bind_result(p, c);
}

}  // namespace zloam::odometry
