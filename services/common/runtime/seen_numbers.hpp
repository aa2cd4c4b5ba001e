#pragma once
// The messages of one input key without sweeps, without clock, threads or transport: duplicates by
// (publisher, seq), and the numbers to request (docs/protocol.md, section 3). Messages
// are accepted in order of arrival. Messages that a publisher sent before its first received
// message are not missed.
//
// A number far from the others is refused until the next one in order follows it (as in RFC 3550,
// appendix A.1, for restarted sources): one forged number can't make true ones look old. The memory
// is bounded: the newest publishers, and of each the newest numbers.
//
// Times are of any monotonic clock, ns.

#include <cstdint>
#include <map>
#include <optional>
#include <set>
#include <string>

#include "common/runtime/sequencer.hpp"

namespace zloam::runtime {

class SeenNumbers {
 public:
  explicit SeenNumbers(const SequencerLimits& limits = {}) : limits_(limits) {}

  /// Nothing: a new number; else kDuplicate, or kInvalid for a number out of reach. publisher: a
  /// name whose numbers count from 0. replay: missing numbers are given up only where their
  /// publisher has a successor, after three requests.
  std::optional<Drop> add(const std::string& publisher, std::uint64_t seq, bool replay,
                          std::int64_t now_ns);

  struct Request {
    std::uint64_t first, last;
  };
  /// The next request; doubles its waiting time with each call that returns something. Live, and of
  /// a key without answers by number, numbers missing for too long are given up here.
  std::optional<Request> request(std::int64_t now_ns);

  /// Numbers that were given up.
  std::uint64_t lost() const { return lost_; }
  /// Publishers whose numbers are no longer remembered.
  std::uint64_t forgotten() const { return forgotten_; }
  std::size_t publishers() const { return publishers_.size(); }
  /// Time of the next work if nothing arrives.
  std::optional<std::int64_t> deadline() const;
  /// Replay: the number that has been missing for longer than the limit.
  std::optional<std::uint64_t> overdue(std::int64_t now_ns) const;

 private:
  struct Publisher {
    /// every number below is seen or given up
    std::uint64_t below = 0;
    std::set<std::uint64_t> above;
    /// after a number out of reach: the number that would follow it
    std::optional<std::uint64_t> far_next;
    std::uint64_t heard = 0;
  };
  /// The gap that is waited for: the lowest of one publisher.
  struct Gap {
    std::string instance;
    std::uint64_t first = 0, last = 0;
    std::int64_t since_ns = 0, ask_at_ns = 0, wait_ns = 0;
    int asked = 0;
  };
  Publisher& publisher(const std::string& instance, std::uint64_t seq);
  static bool in_reach(Publisher& publisher, std::uint64_t seq);
  void give_up(Publisher& publisher);
  void note_gap(std::int64_t now_ns);
  bool is_hopeless(const Gap& gap, std::int64_t now_ns) const;
  std::int64_t late_ns() const;
  bool gives_up() const { return !replay_ || !limits_.by_number; }

  static constexpr std::size_t kMemory = 4096;
  static constexpr std::size_t kMostPublishers = 16;
  SequencerLimits limits_;
  bool replay_ = false;
  std::map<std::string, Publisher> publishers_;
  std::optional<Gap> gap_;
  std::uint64_t lost_ = 0;
  std::uint64_t forgotten_ = 0;
  std::uint64_t heard_ = 0;
};

}  // namespace zloam::runtime
