#pragma once
// A network of one process: the C ABI of the Zenoh bridge, answered by the fuzzer. What a stage
// declares is kept here; send() and ask() call it back on the caller's thread.

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
  /// the answers to a get; on any thread
  std::function<std::vector<NetMessage>(std::string_view key)> on_get;
  /// what a stage publishes or replies; on any thread
  std::function<void(std::string_view encoding, std::span<const std::uint8_t>)> on_put;
};

/// In force until the next call; the entities of the one before must be gone.
void set_network(Network network);
/// To all subscribers whose key expression matches.
void send(const NetMessage& message);
/// A liveliness token appears or goes.
void send_token(const std::string& key, bool there);
/// To all queryables whose key expression matches.
void ask(const NetMessage& question, const std::string& parameters);

}  // namespace zloam::fuzz
