#pragma once
// The sections of the robot's file that all stages read. Defaults stand here and nowhere else.

#include <Eigen/Core>
#include <cstdint>
#include <string>
#include <vector>

#include "common/geometry/se3.hpp"
#include "common/runtime/stage_list.hpp"

namespace zloam::runtime {

class Parameters;

struct SensorConfig {
  std::string name = "lidar";
  std::string model = "VLP-16";
};

/// Poses of the sensors in base_link: R = Rz(yaw) Ry(pitch) Rx(roll).
struct MountingConfig {
  Eigen::Vector3d xyz_m = Eigen::Vector3d::Zero();
  Eigen::Vector3d rpy_deg = Eigen::Vector3d::Zero();
  Eigen::Vector3d imu_xyz_m = Eigen::Vector3d::Zero();
  Eigen::Vector3d imu_rpy_deg = Eigen::Vector3d::Zero();
  Pose T_base_lidar() const { return pose_from_xyz_rpy_deg(xyz_m, rpy_deg); }
  Pose T_base_imu() const { return pose_from_xyz_rpy_deg(imu_xyz_m, imu_rpy_deg); }
};

struct ZenohConfig {
  /// `<stage>` in it: each stage is on a host of its own, which has the stage's name in that place
  std::string host = "127.0.0.1";
  /// stage i of stage_list() listens on base_port + i and connects to those behind it; 0: neither
  int base_port = 7460;
  /// replaces the stage's own listen endpoint, e.g. tcp/127.0.0.1:0 for a second instance
  std::vector<std::string> listen;
  /// further endpoints, e.g. the router's
  std::vector<std::string> connect;
  bool shared_memory = true;
  /// every reader has it in its memory too; what does not fit goes through the socket
  int pool_mib = 16;
  int shared_memory_threshold = 3072;
  /// ms of silence after which a peer is given up
  int lease_ms = 2000;
};

struct LogConfig {
  std::string level = "info";
  std::string format = "text";
};

struct FlowConfig {
  /// sweeps under way in replay
  int window = 8;
  std::vector<std::string> sinks = acknowledging_stages();
  /// stages that must be ready before the first sweep of a replay
  std::vector<std::string> wait_for = stages_behind_the_source();
  /// a sweep is published again after so long without progress
  int retransmit_ms = 1000;
};

struct RecoveryConfig {
  /// messages kept by each publisher to be asked for by number: more than a replay's windows, and
  /// at 10 Hz more than it takes to find a frozen host (lease) and a hanging active (1 s)
  int keep_messages = 32;
  int keep_mib = 128;
  /// a gap is asked for after
  int gap_live_ms = 30;
  int gap_replay_ms = 200;
  /// live: given up after; 0: one measured sweep period
  int late_ms = 0;
  /// replay: the run ends with an error after
  int replay_limit_s = 120;
  /// live: sweeps a stage holds before it drops the oldest, and bytes of any queue
  int queue_sweeps = 4;
  int queue_mib = 256;
  /// a second instance of a stage is meant to be there
  bool standby = false;
};

struct SharedConfig {
  std::string robot = "robot";
  SensorConfig sensor;
  MountingConfig mounting;
  ZenohConfig zenoh;
  LogConfig log;
  FlowConfig flow;
  RecoveryConfig recovery;
};

/// Sections of the robot's file that belong to single programs; each reads its own.
std::vector<std::string> owned_sections();

void bind(Parameters& parameters, SharedConfig& config);

}  // namespace zloam::runtime
