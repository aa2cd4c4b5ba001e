#pragma once
// Zenoh's configuration of a stage from the section zenoh of the robot's file.

#include <string>
#include <vector>

#include "common/runtime/config.hpp"
#include "common/zenoh/zenoh.hpp"

namespace zloam::runtime {

/// Where the stage listens and which endpoints it connects to: its own and its siblings' ports.
struct Endpoints {
  std::vector<std::string> listen;
  std::vector<std::string> connect;
};
Endpoints endpoints_of(const ZenohConfig& config, const std::string& stage);

/// A peer: explicit endpoints retried for ever, no multicast, gossip, time stamps, shared memory.
zenoh::Config session_config(const ZenohConfig& config, const Endpoints& endpoints);

}  // namespace zloam::runtime
