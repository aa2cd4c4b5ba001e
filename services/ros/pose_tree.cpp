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

/// T_to_from.
Pose motion_between(const OdometryStep& to, const OdometryStep& from) {
  return to.T_odom_base.inverse() * from.T_odom_base;
}

/// Of the step between two poses.
Matrix6 twist_covariance(const OdometryStep& before, const OdometryStep& step) {
  const double dt_s = 1e-9 * static_cast<double>(step.instant_ns - before.instant_ns);
  return step.step_covariance / (dt_s * dt_s);
}

}  // namespace

Matrix6 about_frame_axes(const Pose& T_frame_base, const Matrix6& tangent_covariance) {
  Matrix6 turned = Matrix6::Zero();
  turned.topLeftCorner<3, 3>() = T_frame_base.linear();
  turned.bottomRightCorner<3, 3>() = T_frame_base.linear();
  return turned * tangent_covariance * turned.transpose();
}

PoseTree::Uncertainty PoseTree::add(const OdometryStep& step) {
  const bool same_frame = !steps_.empty() && steps_.back().epoch == step.epoch;
  const bool same_run = same_frame && steps_.back().run == step.run;
  if (same_run && step.sweep <= steps_.back().sweep) {
    if (last_before(step) != steps_.rend()) return add_late(step);
    // The same recording is replayed again, with the same run.
    steps_.clear();
  }
  const bool goes_on = same_frame && !steps_.empty() && steps_.back().instant_ns < step.instant_ns;
  if (!goes_on) covariance_.setZero();
  Uncertainty found = goes_on ? go_on(step) : Uncertainty{};
  found.pose = about_frame_axes(step.T_odom_base, covariance_);
  join_waiting(step);
  steps_.push_back(step);
  if (steps_.size() > kSteps) steps_.pop_front();
  return found;
}

PoseTree::Uncertainty PoseTree::go_on(const OdometryStep& step) {
  const OdometryStep& before = steps_.back();
  covariance_ = carried(covariance_, motion_between(step, before)) + step.step_covariance;
  return {.twist = twist_covariance(before, step)};
}

PoseTree::Steps::reverse_iterator PoseTree::last_before(const OdometryStep& step) {
  return std::find_if(steps_.rbegin(), steps_.rend(), [&](const OdometryStep& other) {
    return other.epoch == step.epoch && other.instant_ns < step.instant_ns;
  });
}

// The newest pose stays the one from which the next step goes on. A sweep that two instances have
// published, one of which took over from the other, counts once.
PoseTree::Uncertainty PoseTree::add_late(const OdometryStep& step) {
  const auto before = last_before(step);
  Uncertainty found{.twist = twist_covariance(*before, step)};
  const Pose T_newest_late = motion_between(steps_.back(), step);
  const bool is_new = std::none_of(steps_.begin(), steps_.end(), same_sweep(step));
  if (is_new) covariance_ += carried(step.step_covariance, T_newest_late);
  found.pose = about_frame_axes(step.T_odom_base, carried(covariance_, T_newest_late.inverse()));
  join_waiting(step);
  if (is_new) steps_.insert(before.base(), step);
  if (steps_.size() > kSteps) steps_.pop_front();
  return found;
}

void PoseTree::join_waiting(const OdometryStep& step) {
  const auto map = std::find_if(waiting_.begin(), waiting_.end(), same_sweep(step));
  if (map == waiting_.end()) return;
  correct(step, *map);
  waiting_.erase(waiting_.begin(), map + 1);
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
