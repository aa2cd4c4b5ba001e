#include "ros/graph.hpp"

#include <xxhash.h>

#include <algorithm>
#include <bit>
#include <cctype>
#include <cstring>

namespace zloam::ros {
namespace {

constexpr std::string_view kTokens = "@ros2_lv/";
constexpr std::string_view kNone = "%";

/// Slashes are replaced, because a slash would split the token's chunk.
std::string mangled(std::string_view name) {
  if (name.empty()) return std::string(kNone);
  std::string text(name);
  std::replace(text.begin(), text.end(), '/', '%');
  return text;
}

/// domain/session/node/entity/kind/enclave/namespace/node
std::string begin_of(const NodeNames& node, int entity, std::string_view kind) {
  return std::string(kTokens) + std::to_string(node.domain) + "/" + node.zid + "/0/" +
         std::to_string(entity) + "/" + std::string(kind) + "/" + std::string(kNone) + "/" +
         mangled(node.name_space) + "/" + node.node;
}

void put_little(std::uint8_t* to, std::int64_t value) {
  for (int i = 0; i < 8; ++i) {
    to[i] = static_cast<std::uint8_t>(static_cast<std::uint64_t>(value) >> (8 * i));
  }
}

}  // namespace

std::string dds_name(const MessageType& type) {
  std::string name;
  for (const char c : type.name) {
    if (c == '/') {
      name += "::";
    } else {
      name += c;
    }
  }
  return name.insert(name.rfind("::") + 2, "dds_::") + "_";
}

std::string_view hash_of(const MessageType& type, Distro distro) {
  return distro == Distro::kHumble ? "TypeHashNotSupported" : type.hash;
}

std::string text_of(const Qos& qos) {
  return std::string(qos.best_effort ? "2" : "") + ":" + (qos.transient_local ? "1" : "") + ":," +
         std::to_string(qos.depth) + ":,:,:,,";
}

std::string node_token(const NodeNames& node) { return begin_of(node, 0, "NN"); }

std::string topic_token(const NodeNames& node, EntityKind kind, int entity, const Topic& topic) {
  return begin_of(node, entity, kind == EntityKind::kPublisher ? "MP" : "MS") + "/" +
         mangled(topic.name) + "/" + dds_name(topic.type) + "/" +
         std::string(hash_of(topic.type, node.distro)) + "/" + text_of(topic.qos);
}

std::string data_key(const NodeNames& node, const Topic& topic) {
  return std::to_string(node.domain) + topic.name + "/" + dds_name(topic.type) + "/" +
         std::string(hash_of(topic.type, node.distro));
}

std::string every_node(int domain) {
  return std::string(kTokens) + std::to_string(domain) + "/*/*/*/NN/**";
}

Gid gid_of(std::string_view token) {
  static_assert(std::endian::native == std::endian::little);
  const XXH128_hash_t hash = XXH3_128bits(token.data(), token.size());
  Gid gid{};
  std::memcpy(gid.data(), &hash.low64, 8);
  std::memcpy(gid.data() + 8, &hash.high64, 8);
  return gid;
}

Attachment attachment(std::int64_t number, std::int64_t source_ns, const Gid& gid) {
  Attachment bytes{};
  put_little(bytes.data(), number);
  put_little(bytes.data() + 8, source_ns);
  bytes[16] = static_cast<std::uint8_t>(gid.size());
  std::copy(gid.begin(), gid.end(), bytes.begin() + 17);
  return bytes;
}

std::string name_error(std::string_view name) {
  bool begins = true;
  for (const char c : name) {
    const auto code = static_cast<unsigned char>(c);
    if (c == '/' ? begins : std::isalnum(code) == 0 && c != '_') {
      return "only letters, digits and '_' with single slashes between them";
    }
    if (begins && std::isdigit(code) != 0) return "no part may begin with a digit";
    begins = c == '/';
  }
  return begins && !name.empty() ? "no slash at the end" : "";
}

std::string frame_prefix_error(std::string_view prefix) {
  if (!prefix.starts_with('/')) return {};
  return "must not begin with '/': tf2 finds no frame of such a name";
}

std::string no_node_text(const RosConfig& config) {
  const std::string text = "no ROS 2 node is heard on domain " + std::to_string(config.domain);
  if (!config.connect.empty()) {
    return text + " through " + config.connect.front() +
           ": is rmw_zenohd there (ros.connect), and a node?";
  }
  if (!config.listen.empty()) {
    return text + " at " + config.listen.front() + ": is one connected there (ros.listen)?";
  }
  return text + ": none can reach this one, as ros.connect and ros.listen are empty";
}

}  // namespace zloam::ros
