#pragma once
// Wires the integrator to the runtime. Runs on the stage's one worker thread.

#include <functional>
#include <map>
#include <string>
#include <vector>

#include "common/geometry/motion_check.hpp"
#include "common/geometry/trajectory.hpp"
#include "common/runtime/output_files.hpp"
#include "common/runtime/stage.hpp"
#include "integration/integration.hpp"
#include "integration/journal.hpp"
#include "integration/state_file.hpp"

namespace zloam::integration {

void bind(runtime::Parameters& parameters, IntegrationConfig& config);

class IntegrationStage {
 public:
  IntegrationStage(runtime::Stage& stage, const IntegrationConfig& config);

 private:
  using OdometryMessage = runtime::Received<msg::Odometry>;
  using CorrectionMessage = runtime::Received<msg::MapCorrection>;

  void new_run(const msg::Header& first);
  /// Continues the trajectory of an instance that was killed; restart_stage.cpp.
  void restart(const msg::Header& first);
  void take_up(const std::vector<JournalPose>& poses, bool same_run);
  /// Continues bit-exactly; false: no state was left, or it is not of this program.
  bool resume(std::vector<JournalPose>& poses);
  /// Writes the poses that a killed instance left of a live run that does not continue.
  void write_left(const std::vector<JournalPose>& poses);
  void catch_up(const msg::Header& first);
  void begin_journal(const std::vector<JournalPose>& poses);
  void keep_unwritten(const std::string& error);
  void append(const JournalPose& pose);
  std::string implausible(const OdometryMessage& message);
  std::string implausible(const CorrectionMessage& message);
  runtime::Outcome take(const OdometryMessage& message);
  void process(const OdometryMessage& message);
  void take(const CorrectionMessage& message);
  /// poses that can be published now, by work that started at the host's time started_ns
  void publish(const std::vector<FusedPose>& poses, std::int64_t started_ns);
  void publish(const FusedPose& fused, const runtime::Message& cause);
  void say_drift(const FusedPose& fused);
  std::string write_files();
  runtime::CommandReply save(const std::string& arguments_json);
  /// Empty, or a sentence that says what failed.
  std::string write_run(const runtime::OutputFiles::Run& run, const Trajectory& trajectory,
                        const Trajectory& odometry);
  std::string write_to(const std::function<std::string(const std::string&)>& path_of,
                       const runtime::OutputFiles::Run& run, const Trajectory& trajectory,
                       const Trajectory& odometry);

  runtime::Stage& stage_;
  runtime::Inlet* inlet_ = nullptr;
  IntegrationConfig config_;
  Integrator integrator_;
  runtime::Outlet& pose_;
  runtime::FlowAck& ack_;
  // Odometry messages whose pose is not published yet: the poses take their headers.
  std::map<std::uint64_t, runtime::Message> waiting_;
  Trajectory trajectory_;
  Trajectory odometry_;
  MotionCheck odometry_check_;
  MotionCheck correction_check_;
  /// of the newest odometry accepted: corrections are checked at this pose
  Pose T_odom_base_ = Pose::Identity();
  Journal journal_;
  StateFile state_;
  runtime::OutputFiles files_;
  /// the run in which the trajectory began
  runtime::OutputFiles::Run run_;
  std::int64_t last_instant_ns_ = 0;
  /// of this run: lower sweeps were published, by this instance or the one before
  std::uint64_t next_sweep_ = 0;
  bool in_run_ = false;
  bool unsaved_ = false;
};

}  // namespace zloam::integration
