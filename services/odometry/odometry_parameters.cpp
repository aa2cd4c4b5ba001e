#include "odometry/odometry_parameters.hpp"

#include "common/runtime/parameters.hpp"

namespace zloam::odometry {
namespace {

void bind_solver(runtime::Parameters& p, OdometryConfig& c) {
  p.add("odometry.min_correspondences", &c.min_correspondences, {1, 1e6}, "points",
        "minimum number of matched points; with fewer the pose is the prediction")
      .live();
  p.add("odometry.kernel_m", &c.kernel_m, {0.001, 100.0}, "m",
        "width of the robust kernel in the last iterations")
      .live();
  p.add("odometry.correlation", &c.correlation, {1.0, 1e4}, "",
        "divisor of the information, because residuals on one surface are correlated")
      .live();
  p.add("odometry.max_matched_points", &c.max_matched_points, {10, 1e7}, "points",
        "maximum number of points matched per sweep, evenly chosen")
      .live();
  p.add("odometry.window_sweeps", &c.window_sweeps, {1, 1000}, "sweeps",
        "number of earlier sweeps in the target that a sweep is matched against");
  p.add("odometry.voxel_m", &c.voxel_m, {0.05, 50.0}, "m", "edge of the target's coarsest voxels");
}

void bind_motion(runtime::Parameters& p, OdometryConfig& c) {
  p.add("odometry.acceleration_sigma_mps2", &c.acceleration_sigma_mps2, {1e-3, 1e3}, "m/s^2",
        "typical acceleration of the platform, one sigma")
      .live();
  p.add("odometry.angular_acceleration_sigma_radps2", &c.angular_acceleration_sigma_radps2,
        {1e-3, 1e3}, "rad/s^2", "typical angular acceleration of the platform, one sigma")
      .live();
  p.add("odometry.max_turn_radps", &c.max_turn_radps, {0.1, 1e3}, "rad/s",
        "maximum plausible angular rate; faster solutions are rejected")
      .live();
  p.add("odometry.drift_limit", &c.drift_limit, {1e-6, 1.0}, "",
        "health is Degenerate if the points leave a direction with a sigma above this share of 10 "
        "m, or of 1 rad")
      .live();
}

void bind_imu(runtime::Parameters& p, OdometryConfig& c) {
  p.add("odometry.use_imu", &c.use_imu,
        "use the IMU readings attached to sweeps to predict the motion");
  p.add("odometry.imu_force_noise", &c.imu_force_noise, {1e-6, 10.0}, "m/s^2/sqrt(Hz)",
        "white noise of the accelerometer");
  p.add("odometry.imu_rate_noise", &c.imu_rate_noise, {1e-7, 1.0}, "rad/s/sqrt(Hz)",
        "white noise of the gyroscope");
  p.add("odometry.imu_force_bias_mps2", &c.imu_force_bias_mps2, {0.0, 10.0}, "m/s^2",
        "initial sigma of the accelerometer's bias");
  p.add("odometry.imu_rate_bias_radps", &c.imu_rate_bias_radps, {0.0, 1.0}, "rad/s",
        "initial sigma of the gyroscope's bias; a rate below three times this may be rest");
  p.add("odometry.imu_delay_sigma_ms", &c.imu_delay_sigma_ms, {0.0, 1e3}, "ms",
        "initial sigma of the delay of the IMU's stamps");
}

}  // namespace

void bind(runtime::Parameters& p, OdometryConfig& c) {
  bind_solver(p, c);
  bind_motion(p, c);
  bind_imu(p, c);
}

}  // namespace zloam::odometry
