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
  /// `<stage>` in it stands for the stage's name: each stage then runs on the host of that name
  std::string host = "127.0.0.1";
  /// stage i of stage_list() listens on base_port + i and connects to the later stages; 0: neither
  int base_port = 7460;
  /// replaces the stage's own listen endpoint, e.g. tcp/127.0.0.1:0 for a second instance
  std::vector<std::string> listen;
  /// further endpoints, e.g. the router's
  std::vector<std::string> connect;
  bool shared_memory = true;
  /// each reader maps it into its memory too; messages that do not fit are sent through the socket
  int pool_mib = 16;
  int shared_memory_threshold = 3072;
  /// ms of silence after which the link to a peer is closed
  int lease_ms = 2000;
};

struct LogConfig {
  std::string level = "info";
  std::string format = "text";
};

struct FlowConfig {
  /// replay: maximum of sweeps in flight
  int window = 8;
  std::vector<std::string> sinks = acknowledging_stages();
  /// stages that must be ready before the first sweep of a replay
  std::vector<std::string> wait_for = stages_behind_the_source();
  /// a sweep is published again after this long without progress
  int retransmit_ms = 1000;
};

struct RecoveryConfig {
  /// messages that each publisher keeps for requests by number: more than a replay's window, and at
  /// 10 Hz enough for the time to detect a frozen host (lease) and a hanging active (1 s)
  int keep_messages = 32;
  int keep_mib = 128;
  /// time until a missing sweep is requested
  int gap_live_ms = 30;
  int gap_replay_ms = 200;
  /// live: time until a missing sweep is given up; 0: one measured sweep period
  int late_ms = 0;
  /// replay: time until a missing sweep ends the run with an error
  int replay_limit_s = 120;
  /// live: sweeps a stage holds before it drops the oldest, and bytes of any queue
  int queue_sweeps = 4;
  int queue_mib = 256;
  /// a second instance of a stage is expected
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

/// Sections of the robot's file that belong to single programs; each reads only its own.
std::vector<std::string> owned_sections();

void bind(Parameters& parameters, SharedConfig& config);

}  // namespace zloam::runtime
