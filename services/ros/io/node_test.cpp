// Messages on their way to a slow ROS node: which arrive, live and in a replay.

#include "ros/io/node.hpp"

#include <gtest/gtest.h>

#include <chrono>
#include <memory>
#include <string>
#include <thread>

#include "common/zenoh/tests/support.hpp"
#include "ros/graph.hpp"

namespace zloam::ros {
namespace {

using zenoh::test::kPatience;
using zenoh::test::Watched;

constexpr std::size_t kPoseBytes = 700, kCloudBytes = 1'000'000;
constexpr int kClouds = 40, kPosesPerCloud = 2;
// Longer than a message waits before it is dropped (Zenoh: 1 ms), far below the lease of a link.
constexpr std::chrono::milliseconds kPerCloud{40};

/// A reader on the robot's loopback that takes 40 ms for each cloud, on Zenoh's receiving thread,
/// so that its socket fills.
class SlowReader {
 public:
  explicit SlowReader(int port)
      : session_(zenoh::Session::open(zenoh::test::connecting_config(port))),
        clouds_(subscribe("points", kCloudType, kPerCloud, seen_clouds_)),
        maps_(subscribe("map", kCloudType, kPerCloud, seen_maps_)),
        poses_(subscribe("odom", kOdometryType, {}, seen_poses_)) {}

  int clouds() { return seen_clouds_.get(); }
  /// Whether so many arrived in time.
  bool gets_poses(int number) { return reach(seen_poses_, number); }
  bool gets_maps(int number) { return reach(seen_maps_, number); }

 private:
  static bool reach(Watched<int>& seen, int number) {
    return seen.wait([number](int now) { return now >= number; });
  }
  zenoh::Subscriber subscribe(const std::string& topic, const MessageType& type,
                              std::chrono::milliseconds takes, Watched<int>& seen) {
    return session_.declare_subscriber("0/" + topic + "/" + dds_name(type) + "/**",
                                       [takes, &seen](zenoh::Sample&&) {
                                         std::this_thread::sleep_for(takes);
                                         seen.change([](int& number) { ++number; });
                                       });
  }

  Watched<int> seen_clouds_, seen_maps_, seen_poses_;
  zenoh::Session session_;
  zenoh::Subscriber clouds_, maps_, poses_;
};

/// A node with the topics /odom, /points and /map, and their slow reader.
class SlowNode : public testing::Test {
 protected:
  void SetUp() override {
    const auto ends = std::chrono::steady_clock::now() + kPatience;
    while (!is_read() && std::chrono::steady_clock::now() < ends) {
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    }
    ASSERT_TRUE(is_read());
  }

  bool is_read() const { return odom_->matching() && points_->matching() && map_->matching(); }

  static RosConfig config(int port) {
    RosConfig c;
    c.connect = {};
    c.listen = {zenoh::test::endpoint(port)};
    return c;
  }

  void publish(Publication& clouds, bool replay) {
    for (int i = 0; i < kClouds; ++i) {
      clouds.put(Cdr(kCloudBytes), i, replay);
      for (int k = 0; k < kPosesPerCloud; ++k) odom_->put(Cdr(kPoseBytes), i, replay);
    }
  }

  int port_ = zenoh::test::free_port();
  Node node_{config(port_), "node"};
  std::unique_ptr<Publication> odom_ = node_.publish("/odom", kOdometryType, {}),
                               points_ = node_.publish("/points", kCloudType, {.best_effort = true},
                                                       Size::kLarge),
                               map_ = node_.publish("/map", kCloudType, {}, Size::kLarge);
  SlowReader reader_{port_};
};

TEST_F(SlowNode, LiveCloudsThatItHasNoRoomForDisplaceNoPose) {
  publish(*points_, false);
  EXPECT_TRUE(reader_.gets_poses(kClouds * kPosesPerCloud));
  // Otherwise the reader was not slow, and the test shows nothing.
  EXPECT_LT(reader_.clouds(), kClouds);
}

TEST_F(SlowNode, AReplayWaitsForItWithReliableTopics) {
  publish(*map_, true);
  EXPECT_TRUE(reader_.gets_maps(kClouds));
  EXPECT_TRUE(reader_.gets_poses(kClouds * kPosesPerCloud));
}

}  // namespace
}  // namespace zloam::ros
