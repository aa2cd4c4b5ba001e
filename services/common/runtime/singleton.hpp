#pragma once
// Of a stage that there is once in a robot, the elder instance works and a younger one is silent
// (docs/protocol.md, section 15): two drivers of one sensor, two integrations, two robots of one
// name whose networks were joined. Each declares a liveliness token with the time since which it is
// there; all see the same tokens and so agree, and both say what they see.

#include <atomic>
#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <set>
#include <string>
#include <utility>

#include "common/messages/keys.hpp"
#include "common/zenoh/zenoh.hpp"

namespace zloam::runtime {

/// (since, instance): the least is the elder.
using Seniority = std::pair<std::int64_t, std::string>;

/// ".../service/<stage>/<instance>/active/<since_ns>"; nothing for another key.
std::optional<Seniority> seniority_of(const std::string& key);

class Singleton {
 public:
  /// Declares the token and listens for others'. muted: kept up to date from then on.
  Singleton(zenoh::Session& session, const Keys& keys, const std::string& stage, Seniority own,
            std::shared_ptr<std::atomic<bool>> muted);

  /// Asks once, so that tokens on links that are up already are known.
  void ask();
  /// What is to be said of other instances, to both; empty: there are none.
  std::string others() const;

 private:
  void hear(const std::string& key, bool there);

  zenoh::Session& session_;
  std::string stage_, all_;
  Seniority own_;
  std::shared_ptr<std::atomic<bool>> muted_;
  mutable std::mutex mutex_;
  std::set<Seniority> others_;
  std::optional<zenoh::LivelinessToken> token_;
  // Last: its callback ends before what it uses goes.
  std::optional<zenoh::Subscriber> subscriber_;
};

}  // namespace zloam::runtime
