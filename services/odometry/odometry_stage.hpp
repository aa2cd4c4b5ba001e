#pragma once
// Odometry on the runtime: keys, answers and commands around the method (odometry.hpp).

#include <cstdint>
#include <string>
#include <vector>

#include "common/runtime/stage.hpp"
#include "odometry/odometry.hpp"

namespace zloam::odometry {

class OdometryStage {
 public:
  OdometryStage(runtime::Stage& stage, const OdometryConfig& config);

 private:
  using Features = runtime::Received<msg::Features>;

  runtime::Outcome take(const Features& features);
  void process(const Features& features);
  /// The IMU readings in the result are valid until the next call.
  FeatureSweep input_of(const Features& features);
  /// Also publishes the pose.
  OdometryResult locate(const Features& features, const FeatureSweep& input);
  void publish_pose(const Features& features, const OdometryResult& result);
  void publish_features(const Features& features, const OdometryResult& result);
  void publish_sweep(const Features& features, const OdometryResult& result);
  void publish_progress(HeaderFields header);
  void note_figures(const OdometryResult& result);
  void note_imu(const OdometryResult& result);
  /// What keeps the IMU from being used, or makes its readings doubtful; empty: nothing.
  std::string doubts_about_imu(const OdometryResult& result) const;
  void answer_path(runtime::Answer& answer) const;
  void new_run(const msg::Header& first);
  /// Restores what an earlier instance left in the middle of a run; restart_stage.cpp.
  void restart(const msg::Header& first);
  bool reaches(const msg::Header& first, const CommittedSweep& last) const;
  /// The instant of the last commit; nothing: the frame can't be continued.
  std::optional<std::int64_t> continue_frame(
      const msg::Header& first, std::vector<runtime::Received<msg::OdometryFeatures>> commits);
  /// From the first `count` sweeps.
  void restore(std::size_t count, const std::vector<CommittedSweep>& sweeps);
  void publish_again(std::uint64_t run, const std::vector<CommittedSweep>& sweeps);
  /// Restores from the first of these commits and returns their number; 0: too little was kept.
  std::size_t take_up(const std::vector<runtime::Received<msg::OdometryFeatures>>& commits);
  std::size_t take_up_slices(const std::vector<runtime::Received<msg::OdometryFeatures>>& commits);
  void begin_frame(const msg::Header& first,
                   const std::vector<runtime::Received<msg::OdometryFeatures>>& commits);
  void go_on(const msg::Header& first);
  void do_again(std::uint64_t run, std::uint64_t from);
  void catch_up(const msg::Header& first, std::int64_t until_ns);
  /// This process or its link stalled for a while, and queues dropped messages meanwhile.
  bool stood_still_before(const Features& features) const;
  /// Nothing came for so long before it that a constant motion is no valid prediction; a shorter
  /// gap is enough if the frame is too young to know its motion.
  bool is_too_far(const Features& features) const;
  /// Between sweeps, before the present frame; nothing: too few sweeps.
  std::optional<std::int64_t> usual_interval_ns() const;
  void break_frame(std::uint64_t sweep);
  void next_frame();
  void count_frame();
  runtime::CommandReply reset();

  runtime::Stage& stage_;
  const OdometryConfig& config_;
  Odometry odometry_;
  Pose T_base_lidar_;
  std::vector<ImuReading> readings_;
  /// successive sweeps with readings that do not cover them, and successive ones without readings
  std::uint32_t uncovered_in_row_ = 0;
  std::uint32_t silent_in_row_ = 0;
  /// readings have come, in this run or an earlier one
  bool imu_came_ = false;
  runtime::Outlet& pose_;
  runtime::Outlet& features_;
  runtime::Outlet& sweep_;
  runtime::Outlet& progress_;
  runtime::Inlet* inlet_ = nullptr;
  std::vector<msg::StampedPose> path_;
  HeaderFields last_header_;
  std::uint64_t next_sweep_ = 0;
  /// one past the newest sweep processed; those between are dropped
  std::uint64_t done_below_ = 0;
  std::uint32_t odom_epoch_ = 0;
  /// sweeps in the present frame so far
  std::size_t frame_sweeps_ = 0;
  std::int64_t last_instant_ns_ = 0;
  bool in_run_ = false;
};

}  // namespace zloam::odometry
