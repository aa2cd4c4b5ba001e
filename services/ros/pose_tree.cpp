#include "ros/pose_tree.hpp"

#include <algorithm>

namespace zloam::ros {
namespace {

// Sweeps kept to be joined: a sweep's map pose arrives a few sweeps after its odometry.
constexpr std::size_t kSteps = 64;

template <class Step>
auto same_sweep(const Step& step) {
  return [run = step.run, sweep = step.sweep](const auto& other) {
    return other.run == run && other.sweep == sweep;
  };
}

}  // namespace

Matrix6 about_frame_axes(const Pose& T_frame_base, const Matrix6& tangent_covariance) {
  Matrix6 turned = Matrix6::Zero();
  turned.topLeftCorner<3, 3>() = T_frame_base.linear();
  turned.bottomRightCorner<3, 3>() = T_frame_base.linear();
  return turned * tangent_covariance * turned.transpose();
}

PoseTree::Uncertainty PoseTree::add(const OdometryStep& step) {
  const bool goes_on = !steps_.empty() && steps_.back().epoch == step.epoch &&
                       steps_.back().instant_ns < step.instant_ns;
  Uncertainty found;
  if (goes_on) {
    const OdometryStep& before = steps_.back();
    const double dt_s = 1e-9 * static_cast<double>(step.instant_ns - before.instant_ns);
    const Pose T_now_before = step.T_odom_base.inverse() * before.T_odom_base;
    covariance_ = carried(covariance_, T_now_before) + step.step_covariance;
    found.twist = step.step_covariance / (dt_s * dt_s);
  } else {
    covariance_.setZero();
  }
  found.pose = about_frame_axes(step.T_odom_base, covariance_);
  const auto map = std::find_if(waiting_.begin(), waiting_.end(), same_sweep(step));
  if (map != waiting_.end()) {
    correct(step, *map);
    waiting_.erase(waiting_.begin(), map + 1);
  }
  steps_.push_back(step);
  if (steps_.size() > kSteps) steps_.pop_front();
  return found;
}

void PoseTree::add(const MapStep& step) {
  const auto found = std::find_if(steps_.rbegin(), steps_.rend(), same_sweep(step));
  if (found != steps_.rend()) {
    correct(*found, step);
    return;
  }
  waiting_.push_back(step);
  if (waiting_.size() > kSteps) waiting_.pop_front();
}

void PoseTree::correct(const OdometryStep& odometry, const MapStep& map) {
  corrections_.push_back({map.instant_ns, map.T_map_base * odometry.T_odom_base.inverse()});
}

}  // namespace zloam::ros
