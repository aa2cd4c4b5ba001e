// zloam-ros: a ROS 2 node over Zenoh, without ROS. Everything of substance is in graph.hpp (names),
// cdr.hpp (messages), pose_tree.hpp (frames) and ros_stage.hpp (keys).

#include <memory>

#include "ros/ros_parameters.hpp"
#include "ros/ros_stage.hpp"

int main(int argc, char** argv) {
  using namespace zloam;
  ros::RosConfig config;
  std::unique_ptr<ros::RosStage> ros;
  return runtime::run_stage(
      argc, argv,
      {.name = "ros",
       .summary = "publishes poses, clouds and the map to ROS 2 nodes (rmw_zenoh) and subscribes "
                  "to their IMU",
       .bind = [&](runtime::Parameters& p) { bind(p, config); },
       .wire =
           [&](runtime::Stage& stage) { ros = std::make_unique<ros::RosStage>(stage, config); }});
}
