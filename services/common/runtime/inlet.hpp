#pragma once
// One input key: a callback that only queues, and a worker's side that verifies, drops duplicates,
// orders sweeps and requests missing ones (docs/protocol.md, sections 1 to 3).

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "common/messages/verify.hpp"
#include "common/runtime/account.hpp"
#include "schemas/common_generated.h"

namespace zloam::runtime {

/// Result of a message that was passed to its handler. kHeld: not decided yet; it counts as queued
/// until Inlet::settle().
enum class Outcome : std::uint8_t { kProcessed, kNotMine, kFenced, kInvalid, kHeld };

enum class Order : std::uint8_t {
  /// ascending sweep, gaps waited for and requested
  kBySweep,
  /// by arrival; duplicates dropped by (instance, term, seq)
  kAsTheyCome,
};

/// Whether the publisher is one process whose seq defines which sweeps exist (it may skip some), or
/// every sweep must arrive, from whichever replica.
enum class SweepSet : std::uint8_t { kEvery, kPublisherDecides };

struct Message;

struct InletOptions {
  Order order = Order::kBySweep;
  SweepSet sweeps = SweepSet::kEvery;
  /// kPublisherDecides: also in a replay there are sweeps without a message. Of those between the
  /// last message of a publisher that is gone and the first one of its successor, nobody can tell
  /// that there was none: they are requested some times, and then count as left out.
  bool sparse = false;
  /// kEvery: several replicas publish the sweeps, and none knows which sweeps the others still hold
  bool replicas = false;
  /// live, messages keep coming: a silence is a fault. False: they follow the robot's travel, and end
  /// while it stands.
  bool regular = true;
  /// messages belong to no run, whatever their header says: they come from another sensor's process
  bool outside_runs = false;
  /// the last sweep of the run, once handled, ends the run for this stage
  bool ends_run = true;
  /// live: sweeps held before the oldest is dropped as queue_full; 0: recovery.queue_sweeps.
  /// kAsTheyCome: messages held.
  std::size_t newest = 0;
  /// nothing is dropped for lack of room, not even live (poses, corrections, acknowledgements)
  bool lossless = false;
  /// this many of the newest messages are kept and answered to get <key>?kept=1: for a publisher
  /// that is killed and restarted (recall.hpp). Copies: they hold no shared memory.
  std::size_t keep = 0;
  /// false: dropped as invalid before it counts for its sweep, which stays missing. Called on
  /// arrival, and again for waiting messages after a change.
  std::function<bool(const Message&)> admit;
  /// Live, once per message: why its content is implausible given the messages accepted before;
  /// empty: plausible. Dropped as invalid before it counts for its sweep, and reported in health.
  std::function<std::string(const Message&)> implausible;
  /// a sweep was given up here (queue_full, late or lost) and will not be handled: report it
  /// downstream. In order with the handler's calls. reason: a Drop's name or "lost".
  std::function<void(std::uint64_t run, std::uint64_t sweep, std::string_view reason)> on_given_up;
};

using VerifyFunction = VerifyResult (*)(std::span<const std::uint8_t> bytes,
                                        std::string_view encoding);
using HeaderFunction = const msg::Header* (*)(std::span<const std::uint8_t> bytes);

/// A verified message; copying the handle keeps the bytes.
struct Message {
  std::span<const std::uint8_t> bytes;
  const msg::Header* header = nullptr;
  /// owns the bytes: the transport's own, or an aligned copy
  std::shared_ptr<const void> owner;
  std::int64_t received_ns = 0;
  std::int64_t started_ns = 0;
  bool recovered = false;
};

template <class T>
class Received {
 public:
  explicit Received(Message message) : message_(std::move(message)) {}
  const T& operator*() const { return message_of<T>(message_.bytes); }
  const T* operator->() const { return &message_of<T>(message_.bytes); }
  const msg::Header& header() const { return *message_.header; }
  std::uint64_t run() const { return message_.header->run(); }
  std::uint64_t sweep() const { return message_.header->sweep(); }
  bool replay() const { return message_.header->replay(); }
  bool end_of_run() const { return message_.header->end_of_run(); }
  const Message& raw() const { return message_; }
  operator const Message&() const { return message_; }  // NOLINT: the same thing without its type

 private:
  Message message_;
};

/// Progress of an input in order of sweeps within the current run.
struct Arrivals {
  /// one more than the highest sweep received
  std::uint64_t received_below = 0;
  /// lower sweeps not yet received, ascending; of very many only the lowest
  std::vector<std::uint64_t> missing;
};

/// Handle of a declared input.
class Inlet {
 public:
  virtual ~Inlet() = default;
  virtual const std::string& key() const = 0;
  virtual Account account() const = 0;
  /// Treats lower sweeps as handled: where a restored stage continues. Everything that arrived
  /// while it was restoring is handed out, also live. From a handler or before the start.
  virtual void continue_at(std::uint64_t run, std::uint64_t sweep) = 0;
  /// Worker only.
  virtual Arrivals arrivals() const = 0;
  /// Of the newest message that was accepted and that nobody had asked for; while there is none, of
  /// the first answer. 0: nothing has come. Worker only.
  virtual std::uint32_t term() const = 0;
  /// Finishes a message whose handler returned kHeld; work returns its outcome. Worker only.
  virtual void settle(Message message, const std::function<Outcome(const Message&)>& work) = 0;
};

}  // namespace zloam::runtime
