#pragma once
// Asks a running stage on this host for its health, as any client would: for a container's
// healthcheck or a supervisor. A supervisor that ends what fails asks only whether it answers: a
// stage that waits for others, or is degraded, is of more use than one that starts again.

#include <string>

#include "common/runtime/stage.hpp"

namespace zloam::runtime {

struct HealthAnswer {
  /// The stage gave its status, whatever it says
  bool alive = false;
  /// Ready, or degraded but at work
  bool well = false;
  /// one line for people
  std::string text;
};

/// Connects to the stage's own listen endpoint as a client and reads its status. `instance` selects
/// one of several on this host; empty: the first on this host that answers. Never throws.
HealthAnswer ask_health(const SharedConfig& shared, const std::string& stage,
                        const std::string& host, const std::string& instance);

}  // namespace zloam::runtime
