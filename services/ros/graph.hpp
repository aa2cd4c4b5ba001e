#pragma once
// Names that rmw_zenoh gives to nodes, topics and types, and the attachment of each message.
// Source: rmw_zenoh's design page, "Discovery", "Topic and service names" and "Attachments".

#include <array>
#include <cstdint>
#include <string>
#include <string_view>

#include "ros/config.hpp"

namespace zloam::ros {

/// A type with the hash of its definition (REP-2011), which is the same in all supported
/// distributions.
struct MessageType {
  /// in ROS's notation, e.g. nav_msgs/msg/Odometry
  std::string_view name;
  std::string_view hash;
};

inline constexpr MessageType kOdometryType{
    "nav_msgs/msg/Odometry",
    "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0"};
inline constexpr MessageType kPoseType{
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "RIHS01_26432f9803e43727d3c8f668d1fdb3c630f548af631e2f4e31382371bfea3b6e"};
inline constexpr MessageType kTransformsType{
    "tf2_msgs/msg/TFMessage",
    "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"};
inline constexpr MessageType kPathType{
    "nav_msgs/msg/Path", "RIHS01_1957a5bb3cee5da65c4e52e52b65a93df227efce4c20f8458b36e73066ca334b"};
inline constexpr MessageType kCloudType{
    "sensor_msgs/msg/PointCloud2",
    "RIHS01_9198cabf7da3796ae6fe19c4cb3bdd3525492988c70522628af5daa124bae2b5"};
inline constexpr MessageType kDiagnosticsType{
    "diagnostic_msgs/msg/DiagnosticArray",
    "RIHS01_5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e"};
inline constexpr MessageType kImuType{
    "sensor_msgs/msg/Imu",
    "RIHS01_7d9a00ff131080897a5ec7e26e315954b8eae3353c3f995c55faf71574000b5b"};

/// nav_msgs/msg/Odometry -> nav_msgs::msg::dds_::Odometry_
std::string dds_name(const MessageType& type);
/// The hash as it appears in this distribution's keys and tokens.
std::string_view hash_of(const MessageType& type, Distro distro);

/// Quality of service. The defaults are ROS's; tokens contain only values that differ from them.
struct Qos {
  bool best_effort = false;
  bool transient_local = false;
  int depth = 10;
};
std::string text_of(const Qos& qos);

/// A topic by its full name, e.g. /odom.
struct Topic {
  std::string name;
  MessageType type;
  Qos qos;
};

enum class EntityKind { kPublisher, kSubscription };

struct NodeNames {
  Distro distro = Distro::kJazzy;
  int domain = 0;
  /// identifier of the Zenoh session, as Zenoh writes it
  std::string zid;
  /// with its leading slash; empty: the root
  std::string name_space;
  std::string node;
};

/// Liveliness token of the node.
std::string node_token(const NodeNames& node);
/// Liveliness token of one of the node's topics; `entity` is a number unique within the session.
std::string topic_token(const NodeNames& node, EntityKind kind, int entity, const Topic& topic);
/// Key on which the topic's messages are published.
std::string data_key(const NodeNames& node, const Topic& topic);
/// Key expression of the tokens of all nodes in a domain.
std::string every_node(int domain);

using Gid = std::array<std::uint8_t, 16>;
/// A publisher's identifier: the hash of its token, so that every reader computes the same.
Gid gid_of(std::string_view token);

/// Number, time and publisher of one message. A ROS process that cannot parse the attachment aborts
/// (rmw_zenoh #601), so each message carries exactly these 33 bytes.
using Attachment = std::array<std::uint8_t, 33>;
Attachment attachment(std::int64_t number, std::int64_t source_ns, const Gid& gid);

/// Why `name` is not a valid topic or namespace name; empty if it is valid.
std::string name_error(std::string_view name);
/// Why no frame's name may begin with `prefix`; empty: it may.
std::string frame_prefix_error(std::string_view prefix);

/// What to look at where no other node is heard.
std::string no_node_text(const RosConfig& config);

}  // namespace zloam::ros
