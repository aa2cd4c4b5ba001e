#pragma once
// Wires the integrator to the runtime. Runs on the stage's one worker thread.

#include <map>
#include <vector>

#include "common/runtime/stage.hpp"
#include "integration/integration.hpp"
#include "integration/trajectory.hpp"

namespace zloam::integration {

void bind(runtime::Parameters& parameters, IntegrationConfig& config);

class IntegrationStage {
 public:
  IntegrationStage(runtime::Stage& stage, const IntegrationConfig& config);

 private:
  using OdometryMessage = runtime::Received<msg::Odometry>;
  using CorrectionMessage = runtime::Received<msg::MapCorrection>;

  void new_run();
  void take(const OdometryMessage& message);
  void take(const CorrectionMessage& message);
  /// poses that can leave now, by work that began at the host's time
  void publish(const std::vector<FusedPose>& poses, std::int64_t started_ns);
  void publish(const FusedPose& fused, const runtime::Message& cause);
  std::string write_files();
  runtime::CommandReply save(const std::string& arguments_json);
  std::string write_into(const std::string& folder) const;

  runtime::Stage& stage_;
  IntegrationConfig config_;
  Integrator integrator_;
  runtime::Outlet& pose_;
  runtime::FlowAck& ack_;
  // Odometry messages whose pose has not left yet: their headers are the poses'.
  std::map<std::uint64_t, runtime::Message> waiting_;
  std::vector<TrajectoryPose> trajectory_;
  std::vector<TrajectoryPose> odometry_;
  bool unsaved_ = false;
};

}  // namespace zloam::integration
