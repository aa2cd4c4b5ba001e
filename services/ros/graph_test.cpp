// Compares names, tokens and attachments with those of zenoh-ros2-sdk 0.1.8 and rosbags 0.11. In
// tests/integration/test_ros.py both sides read each other's messages.

#include "ros/graph.hpp"

#include <gtest/gtest.h>

#include <string>

namespace zloam::ros {
namespace {

NodeNames node_of(Distro distro) { return {distro, 7, "abc", "/loam", "zenoh_loam"}; }
const Topic kOdom{"/loam/odom", kOdometryType, {}};

TEST(Graph, KeysAndTokensAreThoseOfRmwZenoh) {
  const NodeNames node = node_of(Distro::kJazzy);
  const std::string hash(kOdometryType.hash);
  EXPECT_EQ(node_token(node), "@ros2_lv/7/abc/0/0/NN/%/%loam/zenoh_loam");
  EXPECT_EQ(data_key(node, kOdom), "7/loam/odom/nav_msgs::msg::dds_::Odometry_/" + hash);
  EXPECT_EQ(topic_token(node, EntityKind::kPublisher, 3, kOdom),
            "@ros2_lv/7/abc/0/3/MP/%/%loam/zenoh_loam/%loam%odom/nav_msgs::msg::dds_::Odometry_/" +
                hash + "/::,10:,:,:,,");
}

TEST(Graph, AnEmptyNamespaceIsAPercentSign) {
  NodeNames node = node_of(Distro::kJazzy);
  node.name_space.clear();
  EXPECT_EQ(node_token(node), "@ros2_lv/7/abc/0/0/NN/%/%/zenoh_loam");
}

TEST(Graph, HumbleHasNoHash) {
  const NodeNames node = node_of(Distro::kHumble);
  EXPECT_EQ(data_key(node, kOdom),
            "7/loam/odom/nav_msgs::msg::dds_::Odometry_/TypeHashNotSupported");
}

TEST(Graph, QosSaysWhatIsNotTheDefault) {
  EXPECT_EQ(text_of({}), "::,10:,:,:,,");
  EXPECT_EQ(text_of({true, false, 5}), "2::,5:,:,:,,");
  EXPECT_EQ(text_of({false, true, 1}), ":1:,1:,:,:,,");
}

TEST(Graph, AnAttachmentIsNumberTimeAndPublisher) {
  Gid gid{};
  for (std::size_t i = 0; i < gid.size(); ++i) gid[i] = static_cast<std::uint8_t>(0xA0 + i);
  const Attachment a = attachment(0x0102030405060708, -2, gid);
  EXPECT_EQ(a[0], 8);
  EXPECT_EQ(a[7], 1);
  EXPECT_EQ(a[8], 0xFE);
  EXPECT_EQ(a[15], 0xFF);
  EXPECT_EQ(a[16], 16);
  EXPECT_EQ(a[17], 0xA0);
  EXPECT_EQ(a[32], 0xAF);
}

TEST(Graph, AGidIsTheTokensHash) {
  // Python's xxhash 4.1.0: xxh3_128(b"abc").intdigest(), low half first
  const Gid gid = gid_of("abc");
  const Gid wanted = {0x50, 0x39, 0x2F, 0x89, 0x94, 0x5F, 0xAF, 0x78,
                      0x85, 0x61, 0x3A, 0x73, 0xB6, 0x5A, 0xB0, 0x06};
  EXPECT_EQ(gid, wanted);
}

TEST(Graph, NamesOfTopicsAreChecked) {
  for (const char* good : {"", "a", "robot_2", "fleet/robot_2"}) {
    EXPECT_EQ(name_error(good), "") << good;
  }
  for (const char* bad : {"/a", "a/", "a//b", "2a", "a/2b", "a b", "a*", "a%b", "a-b"}) {
    EXPECT_NE(name_error(bad), "") << bad;
  }
}

TEST(Graph, WhereNoNodeIsHeardTheEndpointToLookAtIsNamed) {
  RosConfig config;
  EXPECT_NE(no_node_text(config).find("domain 0 through tcp/127.0.0.1:7447"), std::string::npos);
  config.connect.clear();
  config.listen = {"tcp/0.0.0.0:7447"};
  EXPECT_NE(no_node_text(config).find("tcp/0.0.0.0:7447"), std::string::npos);
  config.listen.clear();
  EXPECT_NE(no_node_text(config).find("are empty"), std::string::npos);
}

TEST(Graph, NoFrameBeginsWithASlash) {
  for (const char* good : {"", "robot2/", "robot2_"}) EXPECT_EQ(frame_prefix_error(good), "");
  for (const char* bad : {"/", "/robot2/"}) EXPECT_NE(frame_prefix_error(bad), "") << bad;
}

}  // namespace
}  // namespace zloam::ros
