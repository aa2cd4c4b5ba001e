#pragma once
// Configuration of the ROS 2 node.

#include <string>
#include <vector>

namespace zloam::ros {

/// Humble's tokens and keys contain no type hash.
enum class Distro { kHumble, kJazzy, kKilted, kRolling };

struct RosConfig {
  Distro distro = Distro::kJazzy;
  /// ROS_DOMAIN_ID
  int domain = 0;
  /// endpoints of the ROS nodes' router, usually rmw_zenohd
  std::vector<std::string> connect = {"tcp/127.0.0.1:7447"};
  /// endpoints at which ROS nodes may connect to this node, without a router
  std::vector<std::string> listen;
  /// prefix of all topics except /tf, /tf_static and /diagnostics, without outer slashes
  std::string name_space;
  /// prefix of all frame names, for several robots in one tree
  std::string frame_prefix;
  /// a topic of sensor_msgs/msg/Imu that becomes the robot's IMU; empty: none
  std::string imu_topic;
};

}  // namespace zloam::ros
