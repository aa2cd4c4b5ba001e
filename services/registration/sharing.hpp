#pragma once
// How replicas of registration divide the sweeps among themselves (docs/protocol.md, section 5),
// without clock, threads or transport. Every replica receives every sweep; which one computes it
// follows from the sweep's number and the members, without any negotiation. A wrong list of members
// costs work, never a sweep: a sweep that is not reported as done is computed by the next in rank.
//
// Times are of any monotonic clock, ns.

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace zloam::registration {

struct SharingConfig {
  /// the replica of rank r computes a missing sweep after r times this
  int redo_live_ms = 40;
  int redo_replay_ms = 500;
  /// sweeps and MiB held until odometry has received them
  int hold_sweeps = 32;
  int hold_mib = 128;
};

/// Rendezvous hashing: xxh64(le64(sweep) ‖ instance) with the run as the seed.
std::uint64_t weight(std::uint64_t run, std::uint64_t sweep, std::string_view instance);

/// Number of members that precede the instance for this sweep: greater weight first, ties by name.
/// The instance itself need not be listed.
std::size_t rank(std::uint64_t run, std::uint64_t sweep, std::string_view instance,
                 const std::vector<std::string>& members);

/// Progress that odometry reports.
struct Progress {
  std::uint64_t run = 0;
  /// sweeps below are done
  std::uint64_t next_sweep = 0;
  /// one more than the highest sweep received; lower sweeps that are not missing have been received
  std::uint64_t received_below = 0;
  std::vector<std::uint64_t> missing;
};

struct SweepToShare {
  std::uint64_t run = 0, sweep = 0;
  bool replay = false;
  std::size_t bytes = 0;
};

class Sharing {
 public:
  Sharing(std::string instance, const SharingConfig& config)
      : instance_(std::move(instance)), config_(config) {}

  enum class Share : std::uint8_t { kCompute, kHold, kNotMine };
  /// Takes a sweep that arrived, each once. A held sweep is returned by due() later.
  Share take(const SweepToShare& sweep, std::int64_t now_ns);
  /// Whether this replica is the first in rank for the sweep.
  bool first(std::uint64_t run, std::uint64_t sweep) const;

  /// The other members; the own name may be among them.
  void set_members(std::vector<std::string> members);
  void set_progress(Progress progress);

  struct Due {
    std::uint64_t run, sweep;
    /// false: another replica has computed it, or nothing needs it any more
    bool compute;
  };
  /// Held sweeps that are decided, in order; they are no longer held.
  std::vector<Due> due(std::int64_t now_ns);
  std::size_t held() const { return held_.size(); }

 private:
  struct Held {
    SweepToShare sweep;
    std::int64_t arrived_ns;
  };
  bool done(const SweepToShare& sweep) const;
  bool received(const SweepToShare& sweep) const;
  bool redo(const Held& held, std::int64_t now_ns) const;
  std::optional<Due> settle(const Held& held, std::int64_t now_ns) const;
  Due let_go();
  bool full() const;

  std::string instance_;
  SharingConfig config_;
  std::vector<std::string> members_;
  Progress progress_;
  /// of the newest sweep
  std::uint64_t run_ = 0;
  /// of that run
  std::uint64_t newest_ = 0;
  /// by arrival; sweeps of a run come in order
  std::vector<Held> held_;
  std::size_t held_bytes_ = 0;
};

}  // namespace zloam::registration
