#pragma once
// Zenoh's configuration of a stage, from the section zenoh of the robot's file.

#include <cstdint>
#include <string>
#include <vector>

#include "common/runtime/config.hpp"
#include "common/zenoh/zenoh.hpp"

namespace zloam::runtime {

/// Where the stage listens and which endpoints it connects to: its own and its siblings' ports.
struct Endpoints {
  std::vector<std::string> listen;
  std::vector<std::string> connect;
  /// Of two peers only the one with more initiative connects to the other. Peers that connect to
  /// each other at once can get two links; when both are lost (a stage stalled for longer than the
  /// lease) the new link can lack the declarations of one side: its messages are dropped as
  /// "unknown scope" until it is lost in turn.
  std::uint8_t initiative = 0;
};

/// The error of the first entry that is not tcp/HOST:PORT, or an empty text: Zenoh would retry it
/// for ever without an error.
std::string endpoints_error(const std::vector<std::string>& endpoints);

/// The error of zenoh.host if it is not a name or an address alone, or an empty text.
std::string host_error(const std::string& host);

/// Throws ConfigError for an entry of zenoh.connect or zenoh.listen that is not tcp/HOST:PORT.
void check_endpoints(const ZenohConfig& config);

/// Checked. A stage connects to the later stages of the chain; a program outside the chain, or a
/// second instance away from its stage's port, connects to the whole chain.
Endpoints endpoints_of(const ZenohConfig& config, const std::string& stage);

/// A peer: explicit endpoints retried for ever, no multicast, gossip, time stamps, shared memory.
/// Peers learned by gossip are connected to by the same rule, which Zenoh decides by the greater
/// identifier: initiative is its most significant byte for that comparison.
zenoh::Config session_config(const ZenohConfig& config, const Endpoints& endpoints);

/// The entries of zenoh.connect without a link, given the other ends of all links
/// (zenoh::Session::links). An endpoint by name or on this host is compared by its port alone:
/// names are not resolved here, and everything on this host has one address.
std::vector<std::string> without_link(const std::vector<std::string>& endpoints,
                                      const std::vector<std::string>& links);

}  // namespace zloam::runtime
