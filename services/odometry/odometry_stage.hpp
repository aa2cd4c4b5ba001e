#pragma once
// Odometry on the runtime: keys, answers and commands around the method (odometry.hpp).

#include <cstdint>
#include <vector>

#include "common/runtime/stage.hpp"
#include "odometry/odometry.hpp"

namespace zloam::odometry {

class OdometryStage {
 public:
  OdometryStage(runtime::Stage& stage, const OdometryConfig& config);

 private:
  using Features = runtime::Received<msg::Features>;

  void take(const Features& features);
  void publish_pose(const Features& features, const OdometryResult& result);
  void publish_features(const Features& features, const OdometryResult& result);
  void publish_sweep(const Features& features, const OdometryResult& result);
  void publish_progress(HeaderFields header);
  void note_figures(const OdometryResult& result);
  void answer_path(runtime::Answer& answer) const;
  void new_run();
  runtime::CommandReply reset();

  runtime::Stage& stage_;
  Odometry odometry_;
  Pose T_base_lidar_;
  runtime::Outlet& pose_;
  runtime::Outlet& features_;
  runtime::Outlet& sweep_;
  runtime::Outlet& progress_;
  runtime::Inlet* inlet_ = nullptr;
  std::vector<msg::StampedPose> path_;
  HeaderFields last_header_;
  std::uint64_t next_sweep_ = 0;
  std::uint32_t odom_epoch_ = 0;
};

}  // namespace zloam::odometry
