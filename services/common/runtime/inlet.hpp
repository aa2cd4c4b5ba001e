#pragma once
// One input key: a callback that only queues, and a worker's side that verifies, drops second
// copies, puts sweeps in order and asks for what is missing (docs/protocol.md, sections 1 to 3).

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

/// What became of a message that was handed to its handler. kHeld: not decided yet; it counts as
/// queued until Inlet::settle().
enum class Outcome : std::uint8_t { kProcessed, kNotMine, kFenced, kInvalid, kHeld };

enum class Order : std::uint8_t {
  /// ascending sweep, gaps waited for and asked for
  kBySweep,
  /// as they come; second copies dropped by (instance, seq)
  kAsTheyCome,
};

/// Whether the publisher is one process whose seq tells which sweeps exist (it may leave some out),
/// or every sweep must come, from whichever replica.
enum class SweepSet : std::uint8_t { kEvery, kPublisherDecides };

struct Message;

struct InletOptions {
  Order order = Order::kBySweep;
  SweepSet sweeps = SweepSet::kEvery;
  /// kEvery: several replicas publish the sweeps, and none knows what the others still hold
  bool replicas = false;
  /// what comes belongs to no run, whatever its header says: of another sensor's process
  bool outside_runs = false;
  /// the last sweep of the run, once handled, ends the run for this stage
  bool ends_run = true;
  /// live: sweeps held before the oldest is dropped as queue_full; 0: recovery.queue_sweeps.
  /// kAsTheyCome: messages held.
  std::size_t newest = 0;
  /// nothing is dropped for lack of room, live neither (poses, corrections, acknowledgements)
  bool lossless = false;
  /// so many of the newest messages are kept and answered to get <key>?kept=1: for the publisher,
  /// should it be killed and started again (recall.hpp). Copies: they hold no shared memory.
  std::size_t keep = 0;
  /// false: dropped as invalid before it counts for its sweep, which stays missing. Asked when the
  /// message comes, and again for what waits when something has changed.
  std::function<bool(const Message&)> admit;
  /// Live, once a message: why what it says can't be, beside what was accepted before; empty: it
  /// can. Dropped as invalid before it counts for its sweep, and reported in health.
  std::function<std::string(const Message&)> implausible;
  /// a sweep was given up here (queue_full, late or lost) and will not be handled: say so
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
  /// keeps the bytes: the transport's own, or an aligned copy
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

/// What an input in order of sweeps has of the current run.
struct Arrivals {
  /// one more than the highest sweep that has come
  std::uint64_t received_below = 0;
  /// below that and not yet come, ascending; of very many the lowest
  std::vector<std::uint64_t> missing;
};

/// Handle of a declared input.
class Inlet {
 public:
  virtual ~Inlet() = default;
  virtual const std::string& key() const = 0;
  virtual Account account() const = 0;
  /// Sweeps below are taken for handled: where a restored stage goes on. What came while it restored
  /// itself is all handed out, live too. From a handler or before the start.
  virtual void continue_at(std::uint64_t run, std::uint64_t sweep) = 0;
  /// Worker only.
  virtual Arrivals arrivals() const = 0;
  /// The end of a message whose handler said kHeld: work says what became of it. Worker only.
  virtual void settle(Message message, const std::function<Outcome(const Message&)>& work) = 0;
};

}  // namespace zloam::runtime
