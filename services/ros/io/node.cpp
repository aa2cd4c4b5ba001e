#include "ros/io/node.hpp"

#include <nlohmann/json.hpp>
#include <utility>

namespace zloam::ros {
namespace {

// Infix of the keys on which a zenoh-ext advanced publisher answers for its cache and declares its
// presence.
constexpr std::string_view kHistory = "/@adv/pub/";

/// The same as rmw_zenoh's default session: peer, gossip, no multicast, all messages timestamped.
zenoh::Config session_config(const RosConfig& config) {
  zenoh::Config c = zenoh::Config::create_default();
  const auto list = [](const std::vector<std::string>& l) { return nlohmann::json(l).dump(); };
  c.insert_json5("mode", "\"peer\"");
  c.insert_json5("connect/endpoints", list(config.connect));
  c.insert_json5(
      "listen/endpoints",
      list(config.listen.empty() ? std::vector<std::string>{"tcp/127.0.0.1:0"} : config.listen));
  c.insert_json5("connect/exit_on_failure", "false");
  c.insert_json5("connect/timeout_ms", "-1");
  c.insert_json5("scouting/multicast/enabled", "false");
  c.insert_json5("scouting/gossip/enabled", "true");
  c.insert_json5("timestamping/enabled", "true");
  // ROS processes need no shared memory with this one.
  c.insert_json5("transport/shared_memory/enabled", "false");
  c.insert_json5("transport/shared_memory/mode", "\"lazy\"");
  return c;
}

// Zenoh queues each priority by itself. While a message waits for room, it holds the queue of its
// priority: clouds, which never wait, have one of their own.
zenoh::Priority priority_of(const Qos& qos, Size size) {
  if (size == Size::kSmall) return zenoh::Priority::kData;
  return qos.best_effort ? zenoh::Priority::kBackground : zenoh::Priority::kDataLow;
}

zenoh::PublisherOptions options_of(const Qos& qos, Size size, zenoh::CongestionControl when_full) {
  zenoh::PublisherOptions options;
  options.congestion_control = when_full;
  options.priority = priority_of(qos, size);
  options.reliable = !qos.best_effort;
  return options;
}

NodeNames names_of(const RosConfig& config, const std::string& zid, const std::string& name) {
  return {config.distro, config.domain, zid,
          config.name_space.empty() ? "" : "/" + config.name_space, name};
}

}  // namespace

Publication::Publication(zenoh::Session& session, const NodeNames& node, int entity,
                         const Topic& topic, Size size)
    : key_(data_key(node, topic)),
      gid_(gid_of(topic_token(node, EntityKind::kPublisher, entity, topic))),
      live_(session.declare_publisher(
          key_, options_of(topic.qos, size, zenoh::CongestionControl::kDrop))),
      token_(session.declare_liveliness_token(
          topic_token(node, EntityKind::kPublisher, entity, topic))) {
  if (!topic.qos.best_effort) {
    waiting_ = session.declare_publisher(
        key_, options_of(topic.qos, size, zenoh::CongestionControl::kBlock));
  }
  if (!topic.qos.transient_local) return;
  keep_the_last(session, node.zid, entity);
  newest_.emplace([this](const NewestSender::Message& m) { put_waiting(m); },
                  [&session] { session.close(); });
}

// Fails when the session is closed, and so at the end only.
void Publication::put_waiting(const NewestSender::Message& message) {
  try {
    waiting_->put(message.first, message.second);
  } catch (const zenoh::ZenohError&) {
  }
}

void Publication::keep_the_last(zenoh::Session& session, const std::string& zid, int entity) {
  last_ = std::make_shared<Last>();
  const std::string key = key_ + std::string(kHistory) + zid + "/" + std::to_string(entity) + "/_";
  history_ = session.declare_queryable(
      key,
      [last = last_, data = key_](zenoh::Query&& query) {
        const std::lock_guard lock(last->mutex);
        if (last->message) query.reply(data, last->message->first, {}, last->message->second);
      },
      false);
  history_token_ = session.declare_liveliness_token(key);
}

void Publication::put(Cdr message, std::int64_t source_ns, bool replay) {
  const Attachment attached = attachment(++number_, source_ns, gid_);
  const zenoh::Bytes beside = zenoh::Bytes::copy_of(attached);
  const zenoh::Bytes payload = zenoh::Bytes::own(std::move(message));
  if (last_) {
    const std::lock_guard lock(last_->mutex);
    last_->message = {payload, beside};
  }
  if (newest_) {
    newest_->send({payload, beside});
    return;
  }
  zenoh::Publisher& publisher = replay && waiting_ ? *waiting_ : live_;
  publisher.put(payload, beside);
}

Node::Node(const RosConfig& config, const std::string& name)
    : session_(zenoh::Session::open(session_config(config))),
      names_(names_of(config, session_.zid(), name)) {
  token_ = session_.declare_liveliness_token(node_token(names_));
  nodes_ = session_.declare_liveliness_subscriber(
      every_node(config.domain), [others = others_, own = names_.zid](zenoh::Sample&& sample) {
        if (sample.key.find("/" + own + "/") != std::string::npos) return;
        const std::lock_guard lock(others->mutex);
        if (sample.kind == zenoh::SampleKind::kPut) {
          ++others->count;
        } else if (others->count > 0) {
          --others->count;
        }
      });
}

std::size_t Node::others() const {
  const std::lock_guard lock(others_->mutex);
  return others_->count;
}

std::unique_ptr<Publication> Node::publish(const std::string& topic, const MessageType& type,
                                           const Qos& qos, Size size) {
  return std::make_unique<Publication>(session_, names_, ++entities_, Topic{topic, type, qos},
                                       size);
}

void Node::subscribe(const std::string& topic, const MessageType& type, const Qos& qos,
                     std::function<void(zenoh::Sample&&)> callback) {
  const Topic full{topic, type, qos};
  const std::string token = topic_token(names_, EntityKind::kSubscription, ++entities_, full);
  auto subscriber = session_.declare_subscriber(data_key(names_, full), std::move(callback));
  subscriptions_.emplace_back(session_.declare_liveliness_token(token), std::move(subscriber));
}

}  // namespace zloam::ros
