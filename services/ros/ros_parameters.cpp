#include "ros/ros_parameters.hpp"

#include "ros/graph.hpp"

namespace zloam::ros {

using runtime::Effect;

void bind(runtime::Parameters& p, RosConfig& c) {
  p.add("ros.distro", &c.distro,
        {{"humble", Distro::kHumble},
         {"jazzy", Distro::kJazzy},
         {"kilted", Distro::kKilted},
         {"rolling", Distro::kRolling}},
        "ROS 2 distribution of the nodes; Humble's topics carry no type hash", Effect::kNone);
  p.add("ros.domain", &c.domain, {0, 232}, "", "ROS_DOMAIN_ID", Effect::kNone);
  p.add("ros.connect", &c.connect, "endpoints of the ROS nodes' router (rmw_zenohd)",
        Effect::kNone);
  p.add("ros.listen", &c.listen, "endpoints that ROS nodes may connect to, without a router",
        Effect::kNone);
  p.add("ros.namespace", &c.name_space,
        "namespace of all topics except /tf, /tf_static and /diagnostics, without outer slashes; "
        "empty: the root",
        Effect::kNone);
  p.add("ros.frame_prefix", &c.frame_prefix, "prefix of all frame names, e.g. robot2/",
        Effect::kNone);
  p.add("ros.imu_topic", &c.imu_topic,
        "topic of sensor_msgs/msg/Imu that is used as the robot's IMU (driver.imu: zenoh), e.g. "
        "/imu; empty: no topic",
        Effect::kNone);
  p.check("ros.namespace", [&c] { return name_error(c.name_space); });
  p.check("ros.frame_prefix", [&c] { return frame_prefix_error(c.frame_prefix); });
  p.check("ros.imu_topic", [&c]() -> std::string {
    if (c.imu_topic.empty()) return {};
    return c.imu_topic.front() == '/' ? name_error(c.imu_topic.substr(1)) : "must begin with '/'";
  });
}

}  // namespace zloam::ros
