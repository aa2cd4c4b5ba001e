#pragma once
// A-LOAM's odometry on the runtime: keys, answers and commands around the method.

#include <cstdint>
#include <optional>
#include <vector>

#include "aloam/config.hpp"
#include "aloam/core/scan_to_scan.hpp"
#include "common/runtime/stage.hpp"

namespace zloam::aloam {

class OdometryStage {
 public:
  OdometryStage(runtime::Stage& stage, const AloamConfig& config);

 private:
  using Features = runtime::Received<msg::Features>;
  using Commit = runtime::Received<msg::OdometryFeatures>;

  /// The result of one sweep, frame base_link.
  struct Located {
    std::int64_t instant_ns = 0;
    Pose T_odom_base = Pose::Identity();
    Vector6 twist_per_s = Vector6::Zero();
    Health health = Health::kOk;
    ScanMotion motion;
  };

  runtime::Outcome take(const Features& features);
  void process(const Features& features);
  Located locate(const Features& features);
  void publish_pose(const Features& features, const Located& located);
  void publish_features(const Features& features, const Located& located);
  void publish_progress(HeaderFields header);
  void note_figures(const Located& located);
  void answer_path(runtime::Answer& answer) const;
  void new_run(const msg::Header& first);
  /// An instance before this one was in the middle of the run: goes on from its last sweep where
  /// that can be had, else in a new odom frame.
  void restart(const msg::Header& first);
  void restore(const std::vector<Commit>& commits);
  /// Of the run from this sweep on, as far as registration still has it.
  void catch_up(std::uint64_t run, std::uint64_t from);
  runtime::CommandReply reset();

  runtime::Stage& stage_;
  ScanToScan odometry_;
  Pose T_base_lidar_;
  runtime::Outlet& pose_;
  runtime::Outlet& features_;
  runtime::Outlet& sweep_;
  runtime::Outlet& progress_;
  runtime::Inlet* inlet_ = nullptr;
  std::vector<msg::StampedPose> path_;
  HeaderFields last_header_;
  std::optional<std::uint64_t> prev_sweep_;
  std::uint64_t next_sweep_ = 0;
  std::uint32_t odom_epoch_ = 0;
  std::int64_t last_instant_ns_ = 0;
  bool deskew_ = false;
  bool in_run_ = false;
};

}  // namespace zloam::aloam
