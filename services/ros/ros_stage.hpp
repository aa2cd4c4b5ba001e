#pragma once
// Connects the ROS 2 node to the runtime: publishes the stages' results as ROS messages, and hands
// the messages of an IMU and of /initialpose on to the stages.

#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "common/runtime/all_tiles.hpp"
#include "common/runtime/async_get.hpp"
#include "common/runtime/on_demand.hpp"
#include "common/runtime/stage.hpp"
#include "ros/cdr.hpp"
#include "ros/config.hpp"
#include "ros/io/node.hpp"
#include "ros/passing_reason.hpp"
#include "ros/placed_sweeps.hpp"
#include "ros/pose_tree.hpp"
#include "ros/shown_tiles.hpp"
#include "ros/thinned_path.hpp"
#include "ros/unusable.hpp"

namespace zloam::ros {

class RosStage {
 public:
  RosStage(runtime::Stage& stage, const RosConfig& config);

 private:
  void wire();
  void new_run(const msg::Header& first);
  void begin_map(std::uint64_t map_id);
  void take(const runtime::Received<msg::Odometry>& odometry);
  void take(const runtime::Received<msg::MapPose>& pose);
  void take_mapped(const runtime::Received<msg::MapPose>& mapped);
  void say_corrections();
  void say_mounting();
  /// say_points(), take_imu() and take_places() run every 20 ms, the path, the map and the
  /// diagnostics once a second.
  void say_points();
  void say_path();
  void take_tiles();
  void say_map();
  void take_tile(const zenoh::Sample& sample);
  void say_diagnostics();
  void take_statuses();
  void take_imu();
  std::string refusal_of(const std::vector<zenoh::Sample>& answers) const;
  void take_places();
  void place(const PlaceMessage& said);
  void look_for_nodes();

  std::string frame(const std::string& name) const { return config_.frame_prefix + name; }
  std::string topic(const std::string& name) const;
  Diagnostic of_pose() const;

  struct Heard {
    Diagnostic diagnostic;
    std::int64_t stamp_ns = 0;
  };

  runtime::Stage& stage_;
  RosConfig config_;
  Node node_;
  std::unique_ptr<Publication> odometry_, pose_, transforms_, static_transforms_, path_, points_,
      map_, diagnostics_;
  runtime::Outlet* imu_ = nullptr;
  runtime::OnDemand clouds_, tiles_, statuses_;
  runtime::Mailbox readings_, places_;
  Unusable unread_imu_;
  runtime::AllTiles all_tiles_;
  runtime::AsyncGet placing_;
  /// of the last /initialpose
  PassingReason refusal_;
  std::shared_ptr<runtime::Shared> bell_ = std::make_shared<runtime::Shared>();

  /// whether the last message belonged to a replay
  bool replay_ = false;
  PoseTree tree_;
  std::int64_t last_odometry_ns_ = 0;
  ThinnedPath path_of_run_;
  bool path_grew_ = false;
  PlacedSweeps placed_;
  std::deque<zenoh::Sample> waiting_clouds_;
  ShownTiles map_tiles_;
  std::optional<std::uint64_t> map_id_;
  bool map_grew_ = false;
  std::int64_t last_map_ns_ = 0;
  std::map<std::string, Heard> heard_;
  Health health_ = Health::kOk;
  std::int64_t last_pose_ns_ = 0;
  std::int64_t began_ns_ = 0;
};

}  // namespace zloam::ros
