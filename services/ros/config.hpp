#pragma once
// What the configuration says about ROS 2's side.

#include <string>
#include <vector>

namespace zloam::ros {

/// Humble's tokens and keys hold no hash of the type.
enum class Distro { kHumble, kJazzy, kKilted, kRolling };

struct RosConfig {
  Distro distro = Distro::kJazzy;
  /// ROS_DOMAIN_ID
  int domain = 0;
  /// rmw_zenohd, or whichever router the ROS nodes are linked to
  std::vector<std::string> connect = {"tcp/127.0.0.1:7447"};
  /// where ROS nodes may connect to this one, without a router
  std::vector<std::string> listen;
  /// before all topics but /tf and /tf_static, without outer slashes
  std::string name_space;
  /// before all frames, for several robots in one tree
  std::string frame_prefix;
  /// a topic of sensor_msgs/msg/Imu that becomes the robot's IMU; empty: none
  std::string imu_topic;
};

}  // namespace zloam::ros
