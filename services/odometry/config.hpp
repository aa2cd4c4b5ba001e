#pragma once
// Configuration of the odometry stage. Every default is written here and nowhere else.
//
// Fields that odometry_parameters.cpp does not bind are constants of the method: chosen on the
// worlds of docs/experiments, where a better value for one world lost another. zloam-offline sets
// them for experiments.

namespace zloam::odometry {

struct OdometryConfig {
  // --- solver -------------------------------------------------------------------------------
  /// Stops earlier when a step is below both limits.
  int max_iterations = 50;
  double stop_translation_m = 1e-4;
  double stop_rotation_rad = 2e-5;
  /// With fewer matched points than this the pose is the prediction.
  int min_correspondences = 30;
  /// Geman-McClure kernel: its width starts at kernel_start_m, is halved by each iteration and ends
  /// at kernel_m. Residuals above three widths are ignored.
  double kernel_m = 0.1;
  double kernel_start_m = 0.4;
  /// Residuals on one surface are correlated: their information is divided by this.
  double correlation = 10.0;

  // --- motion prior -------------------------------------------------------------------------
  /// Assumed error of the end of the sweep before, where no covariance of it is known, one sigma; a
  /// measurement is compared with it to decide whether a direction is degenerate.
  double begin_sigma_m = 0.003;
  double begin_sigma_rad = 0.002;
  /// Upper limit of the pose part of a sweep's covariance, one sigma: however poorly the sweep was
  /// constrained, the window around it was built from its pose.
  double pose_sigma_m = 0.003;
  double pose_sigma_rad = 0.002;
  /// Difference allowed between a sweep's begin and the end of the sweep before, one sigma: motions
  /// are continuous, constant twists nearly are. This share of the last change of the twist is
  /// added to the sigma.
  double continuity_sigma_m = 0.0003;
  double continuity_sigma_rad = 0.0002;
  double continuity_share = 0.03;
  /// The twist changes from sweep to sweep by about this acceleration, one sigma.
  double acceleration_sigma_mps2 = 3.0;
  double angular_acceleration_sigma_radps2 = 2.0;
  /// Twist of the first sweep, one sigma about rest.
  double initial_speed_sigma_mps = 2.0;
  double initial_rate_sigma_radps = 2.0;
  /// Maximum plausible angular rate: a faster solution is rejected, and the next sweep is matched
  /// from rest. Bare ground looks the same after any rotation: a wrong one would predict the next.
  double max_turn_radps = 20.0;

  // --- inertial sensor, where one comes with the sweeps --------------------------------------
  bool use_imu = true;
  /// White noise of the accelerometer, m/s^2/sqrt(Hz), and of the gyroscope, rad/s/sqrt(Hz): three
  /// times and twice that of a MEMS unit of the class that robots carry (Xsens MTi-10), because
  /// platforms vibrate.
  double imu_force_noise = 2e-3;
  double imu_rate_noise = 1e-3;
  /// Other errors of a sweep's mean force (time stamps, mounting), and of the rotation by its size.
  double imu_force_error_mps2 = 0.02;
  double imu_scale_error = 0.002;
  /// Biases, one sigma at the start, and the drift per second of the biases and of gravity (the
  /// odom frame's tilt).
  double imu_force_bias_mps2 = 0.2;
  double imu_rate_bias_radps = 0.01;
  double imu_force_walk = 1e-3;
  double imu_rate_walk = 1e-4;
  double imu_gravity_walk = 2e-3;
  /// The same for the delay of the IMU's stamps.
  double imu_delay_sigma_ms = 5.0;
  double imu_delay_walk_ms = 0.1;
  /// Errors of the normals make an open direction look constrained: information that errors of this
  /// size can explain is left to the IMU.
  double imu_normal_error_rad = 0.035;
  /// Acceleration of the platform in its first sweep: when moving, and when it seems to be at rest.
  double imu_start_acceleration_mps2 = 0.5;
  double imu_rest_acceleration_mps2 = 0.02;

  // --- slices of a scan that covers the field only after many of them ---------------------------
  /// The motion changes from slice to slice by about these accelerations, one sigma.
  double slice_acceleration_sigma_mps2 = 0.1;
  double slice_angular_acceleration_sigma_radps2 = 0.1;
  /// With an IMU: error of the mean force over a slice.
  double slice_force_sigma_mps2 = 0.05;

  // --- matching against recent sweeps -------------------------------------------------------
  /// Sweeps kept in the target.
  int window_sweeps = 20;
  /// Edge of the coarsest voxels, m; each level halves it.
  double voxel_m = 2.0;
  int voxel_levels = 4;
  /// At most about this many points of a sweep are matched (evenly spread).
  int max_matched_points = 4000;
  /// A denser sweep is thinned to every n-th point, with n such that at least this many remain.
  int enough_inserted_points = 20000;
  /// A voxel is a plane when it has this many points, its thickness (square root of the smallest
  /// eigenvalue) is below thickness_sigmas range noises, its width (of the middle one) is above
  /// width_sigmas, and the normal's error is below normal_error_rad. A ring thickened by noise is
  /// rejected: such a plane would contain the beam.
  int plane_min_points = 8;
  double plane_thickness_sigmas = 1.4;
  double plane_width_sigmas = 3.0;
  double plane_normal_error_rad = 0.05;

  // --- published result ---------------------------------------------------------------------
  /// A direction is degenerate when its sigma from the points alone exceeds this share of 10 m, or
  /// of a radian.
  double drift_limit = 0.01;
  /// Published covariance: the solver's, times this (from comparison with ground truth).
  double covariance_scale = 1.0;
  /// Reset the target after this many consecutive sweeps with points and without a match.
  int restart_after = 10;
};

}  // namespace zloam::odometry
