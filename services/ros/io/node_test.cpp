// Messages on their way to a slow ROS node: which arrive, live and in a replay.

#include "ros/io/node.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <cstddef>
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
        newest_(subscribe("newest", kCloudType, kPerCloud, seen_newest_)),
        poses_(subscribe("odom", kOdometryType, {}, seen_poses_)) {}

  ~SlowReader() { stall(false); }

  /// While it is stalled, it takes nothing.
  void stall(bool stalled) {
    stalled_.change([stalled](bool& now) { now = stalled; });
  }
  int clouds() { return seen_clouds_.get(); }
  int newest() { return seen_newest_.get(); }
  /// Whether so many arrived in time.
  bool gets_poses(int number) { return reach(seen_poses_, number); }
  bool gets_maps(int number) { return reach(seen_maps_, number); }
  bool gets_payload(std::size_t bytes) {
    return largest_.wait([bytes](std::size_t now) { return now >= bytes; });
  }

 private:
  static bool reach(Watched<int>& seen, int number) {
    return seen.wait([number](int now) { return now >= number; });
  }
  zenoh::Subscriber subscribe(const std::string& topic, const MessageType& type,
                              std::chrono::milliseconds takes, Watched<int>& seen) {
    return session_.declare_subscriber(
        "0/" + topic + "/" + dds_name(type) + "/**", [takes, &seen, this](zenoh::Sample&& sample) {
          std::this_thread::sleep_for(takes);
          stalled_.wait([](bool stalled) { return !stalled; });
          largest_.change(
              [&sample](std::size_t& bytes) { bytes = std::max(bytes, sample.payload.size()); });
          seen.change([](int& number) { ++number; });
        });
  }

  Watched<int> seen_clouds_, seen_maps_, seen_newest_, seen_poses_;
  Watched<std::size_t> largest_;
  Watched<bool> stalled_;
  zenoh::Session session_;
  zenoh::Subscriber clouds_, maps_, newest_, poses_;
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

  bool is_read() const {
    return odom_->matching() && points_->matching() && map_->matching() && newest_->matching();
  }

  static RosConfig config(int port) {
    RosConfig c;
    c.connect = {};
    c.listen = {zenoh::test::endpoint(port)};
    return c;
  }

  void publish_once(Publication& clouds, bool replay) {
    clouds.put(Cdr(kCloudBytes), 0, replay);
    for (int k = 0; k < kPosesPerCloud; ++k) odom_->put(Cdr(kPoseBytes), 0, replay);
  }
  void publish(Publication& clouds, bool replay) {
    for (int i = 0; i < kClouds; ++i) publish_once(clouds, replay);
  }

  int port_ = zenoh::test::free_port();
  Node node_{config(port_), "node"};
  std::unique_ptr<Publication> odom_ = node_.publish("/odom", kOdometryType, {}),
                               points_ = node_.publish("/points", kCloudType, {.best_effort = true},
                                                       Size::kLarge),
                               map_ = node_.publish("/map", kCloudType, {}, Size::kLarge),
                               newest_ = node_.publish("/newest", kCloudType,
                                                       {.transient_local = true}, Size::kLarge);
  SlowReader reader_{port_};
};

TEST_F(SlowNode, LiveCloudsThatItHasNoRoomForDisplaceNoPose) {
  publish(*points_, false);
  EXPECT_TRUE(reader_.gets_poses(kClouds * kPosesPerCloud));
  // Otherwise the reader was not slow, and the test shows nothing.
  EXPECT_LT(reader_.clouds(), kClouds);
}

TEST_F(SlowNode, TheNewestMessageOfATransientLocalTopicArrivesBesideClouds) {
  for (int i = 0; i < kClouds; ++i) {
    newest_->put(Cdr(kCloudBytes + static_cast<std::size_t>(i)), i, false);
    publish_once(*points_, false);
  }
  EXPECT_TRUE(reader_.gets_payload(kCloudBytes + kClouds - 1));
  EXPECT_TRUE(reader_.gets_poses(kClouds * kPosesPerCloud));
  // Older ones were left out, and clouds dropped: otherwise the reader was not slow.
  EXPECT_LT(reader_.newest(), kClouds);
  EXPECT_LT(reader_.clouds(), kClouds);
}

TEST_F(SlowNode, ItsPublicationEndsWhileAMessageWaits) {
  reader_.stall(true);
  // More than the socket's buffers hold.
  newest_->put(Cdr(20 * kCloudBytes), 0, false);
  newest_.reset();
  EXPECT_EQ(reader_.newest(), 0);
}

TEST_F(SlowNode, AReplayWaitsForItWithReliableTopics) {
  publish(*map_, true);
  EXPECT_TRUE(reader_.gets_maps(kClouds));
  EXPECT_TRUE(reader_.gets_poses(kClouds * kPosesPerCloud));
}

}  // namespace
}  // namespace zloam::ros
