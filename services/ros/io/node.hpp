#pragma once
// A ROS 2 node on a Zenoh session of its own. It declares its publishers and subscriptions as
// rmw_zenoh does, so that every ROS node lists them.

#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>

#include "common/zenoh/zenoh.hpp"
#include "ros/cdr.hpp"
#include "ros/graph.hpp"
#include "ros/io/newest_sender.hpp"

namespace zloam::ros {

/// Large messages that fill their queue on the way to a slow node displace no poses.
enum class Size : std::uint8_t { kSmall, kLarge };

/// A topic that this node publishes. put() from one thread.
class Publication {
 public:
  Publication(zenoh::Session& session, const NodeNames& node, int entity, const Topic& topic,
              Size size);

  /// Whether the topic has a subscriber now.
  bool matching() const { return live_.matching(); }
  /// Live, a slow ROS node must not block the robot: messages that it has no room for are dropped.
  /// In a replay, those of reliable topics wait for it. The newest message of a transient-local topic
  /// always arrives: it waits for the node on a thread of its own.
  void put(Cdr message, std::int64_t source_ns, bool replay);

 private:
  /// The last message, for late subscribers of a transient-local topic.
  struct Last {
    std::mutex mutex;
    std::optional<NewestSender::Message> message;
  };
  void keep_the_last(zenoh::Session& session, const std::string& zid, int entity);
  void put_waiting(const NewestSender::Message& message);

  std::string key_;
  Gid gid_;
  zenoh::Publisher live_;
  /// for messages that wait for slow nodes; reliable topics only
  std::optional<zenoh::Publisher> waiting_;
  zenoh::LivelinessToken token_;
  std::shared_ptr<Last> last_;
  std::optional<zenoh::Queryable> history_;
  std::optional<zenoh::LivelinessToken> history_token_;
  std::int64_t number_ = 0;
  /// of a transient-local topic; ends before the publisher that it uses
  std::optional<NewestSender> newest_;
};

class Node {
 public:
  /// Throws zenoh::ZenohError if a listen endpoint is in use.
  Node(const RosConfig& config, const std::string& name);

  std::unique_ptr<Publication> publish(const std::string& topic, const MessageType& type,
                                       const Qos& qos, Size size = Size::kSmall);
  /// The callback runs on Zenoh's threads.
  void subscribe(const std::string& topic, const MessageType& type, const Qos& qos,
                 std::function<void(zenoh::Sample&&)> callback);
  /// Other nodes in the domain.
  std::size_t others() const;

 private:
  struct Others {
    std::mutex mutex;
    std::size_t count = 0;
  };
  zenoh::Session session_;
  NodeNames names_;
  int entities_ = 0;
  std::shared_ptr<Others> others_ = std::make_shared<Others>();
  std::optional<zenoh::LivelinessToken> token_;
  std::optional<zenoh::Subscriber> nodes_;
  std::vector<std::pair<zenoh::LivelinessToken, zenoh::Subscriber>> subscriptions_;
};

}  // namespace zloam::ros
