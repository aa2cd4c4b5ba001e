#pragma once
// For a stage that exists once in a robot, one instance works and the others are silent
// (docs/protocol.md, sections 6 and 15): standbys, two drivers of one sensor, two robots of one
// name whose networks were joined. Each declares a liveliness token with its term and its start
// time. The greatest term works; among equal terms the earliest start. All see the same tokens and
// so agree, and each reports what it sees. Who comes later is younger, whatever the hosts' clocks
// say, as long as it hears the others before it declares its own token: its start time is later
// than that of every token that it found. Over a link that takes longer the clocks decide.

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

/// Ascending: the least of several is the active one.
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

/// A term grows by one with each take-over. One that is far above all that an instance knows is a
/// stranger's: if it counted, no later instance could have a greater one.
constexpr bool is_plausible_term(std::uint32_t term, std::uint32_t known) {
  constexpr std::uint32_t kMostAhead = 1U << 16;
  return term <= known || term - known <= kMostAhead;
}

/// ".../service/<stage>/<instance>/active/<term>/<since_ns>"; nothing for another key.
std::optional<Seniority> seniority_of(const std::string& key);

class Singleton {
 public:
  /// Subscribes to others' tokens. muted: kept up to date from then on.
  Singleton(zenoh::Session& session, const Keys& keys, const std::string& stage, Seniority own,
            std::shared_ptr<std::atomic<bool>> muted);

  /// Asks once, so that tokens on existing links are known.
  void ask();

  // Worker only, not for callbacks.
  /// Declares the token, later than all that have been heard. Once only: later calls do nothing.
  void enter();
  /// Takes a term above all terms received: instances with lower terms no longer take precedence,
  /// here or, once they receive the new term, there.
  void take_over();
  /// Raises the own term to at least one that this stage's messages had.
  void at_least(std::uint32_t term);
  /// Silent regardless of the others, while one of them is asked to take over.
  void hold(bool silent);

  // Any thread.
  std::uint32_t term() const { return term_.load(); }
  /// Another instance has a greater term: this one's state is outdated.
  bool overtaken() const;
  /// An instance that this one has overtaken is still there.
  bool has_passed() const;
  /// The active instance, if it is not this one.
  std::optional<Seniority> elder() const;
  /// Instances that could take over, the eldest first.
  std::vector<std::string> juniors() const;
  /// Text about other instances, for status and log of both; empty: there are none.
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
  /// of all tokens received, also of those that are gone
  std::uint32_t greatest_ = 0;
  bool held_ = false;
  bool has_entered_ = false;
  std::optional<zenoh::LivelinessToken> token_;
  // Last: its callback must end before the members it uses are destroyed.
  std::optional<zenoh::Subscriber> subscriber_;
};

}  // namespace zloam::runtime
