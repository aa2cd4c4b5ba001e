#pragma once
// A network within one process: the C ABI of the Zenoh bridge, implemented for the fuzzer. It keeps
// the subscribers and queryables that a stage declares; send() and ask() call them on the caller's
// thread.

#include <cstdint>
#include <functional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace zloam::fuzz {

struct NetMessage {
  std::string key;
  std::string encoding;
  std::vector<std::uint8_t> payload;
};

struct Network {
  /// returns the answers to a get; called on any thread
  std::function<std::vector<NetMessage>(std::string_view key)> on_get;
  /// receives everything that a stage publishes or replies; called on any thread
  std::function<void(std::string_view encoding, std::span<const std::uint8_t>)> on_put;
};

/// Sets the network until the next call. All entities declared on the previous one must be gone.
void set_network(Network network);
/// Sends the message to all subscribers whose key expression matches.
void send(const NetMessage& message);
/// Reports a liveliness token as declared (`there`) or withdrawn.
void send_token(const std::string& key, bool there);
/// Sends the query to all queryables whose key expression matches.
void ask(const NetMessage& question, const std::string& parameters);

}  // namespace zloam::fuzz
