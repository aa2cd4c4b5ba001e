#pragma once
// Of a stage that there is once in a robot, one instance works and the others are silent
// (docs/protocol.md, sections 6 and 15): standbys, two drivers of one sensor, two robots of one name
// whose networks were joined. Each declares a liveliness token with its term and the time since
// which it is there. The greatest term works; of one term, who was there first. All see the same
// tokens and so agree, and each says what it sees.

#include <atomic>
#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <set>
#include <string>
#include <tuple>
#include <vector>

#include "common/messages/keys.hpp"
#include "common/zenoh/zenoh.hpp"

namespace zloam::runtime {

/// Ascending: the least of several is the one that works.
struct Seniority {
  /// one more each time another instance took over
  std::uint32_t term = 1;
  std::int64_t since_ns = 0;
  std::string instance{};

  friend bool operator==(const Seniority&, const Seniority&) = default;
  friend bool operator<(const Seniority& a, const Seniority& b) {
    return std::tie(b.term, a.since_ns, a.instance) < std::tie(a.term, b.since_ns, b.instance);
  }
};

/// ".../service/<stage>/<instance>/active/<term>/<since_ns>"; nothing for another key.
std::optional<Seniority> seniority_of(const std::string& key);

class Singleton {
 public:
  /// Declares the token and listens for others'. muted: kept up to date from then on.
  Singleton(zenoh::Session& session, const Keys& keys, const std::string& stage, Seniority own,
            std::shared_ptr<std::atomic<bool>> muted);

  /// Asks once, so that tokens on links that are up already are known.
  void ask();

  // The worker's, not for callbacks.
  /// A term above all that were heard: those who had them are no elders any more, here or, once
  /// they hear of it, there.
  void take_over();
  /// The own term is no less than one that this stage's messages had.
  void at_least(std::uint32_t term);
  /// Silent whatever the others are, while one of them is asked to take over.
  void hold(bool silent);

  // Any thread.
  std::uint32_t term() const { return term_.load(); }
  /// Another instance has a greater term: what this one knows is old.
  bool overtaken() const;
  /// One that this instance has overtaken is still there.
  bool has_passed() const;
  /// The one that works, where it is not this one.
  std::optional<Seniority> elder() const;
  /// Those that could take over, the eldest first.
  std::vector<std::string> juniors() const;
  /// What is to be said of other instances, to both; empty: there are none.
  std::string others() const;

 private:
  void hear(const std::string& key, bool there);
  void declare(std::uint32_t term);
  std::optional<Seniority> elder_locked() const;

  zenoh::Session& session_;
  const Keys& keys_;
  std::string stage_, all_;
  std::shared_ptr<std::atomic<bool>> muted_;
  std::atomic<std::uint32_t> term_;
  mutable std::mutex mutex_;
  Seniority own_;
  std::set<Seniority> others_;
  /// overtaken by this one
  std::set<Seniority> passed_;
  /// of all that were heard, also of those that have gone
  std::uint32_t greatest_ = 0;
  bool held_ = false;
  std::optional<zenoh::LivelinessToken> token_;
  // Last: its callback ends before what it uses goes.
  std::optional<zenoh::Subscriber> subscriber_;
};

}  // namespace zloam::runtime
