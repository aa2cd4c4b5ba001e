#pragma once
// How replicas of registration divide the sweeps among themselves (docs/protocol.md, section 5),
// without clock, threads or transport. Every replica has every sweep; who computes it follows from
// the sweep's number and the members, so that nobody need ask anybody. A wrong view of the members
// costs work, never a sweep: what is not seen to be done is done by the next in rank.
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
  /// sweeps and MiB held until odometry has them
  int hold_sweeps = 32;
  int hold_mib = 128;
};

/// Rendezvous hashing: xxh64(le64(sweep) ‖ instance) with the run as the seed.
std::uint64_t weight(std::uint64_t run, std::uint64_t sweep, std::string_view instance);

/// How many members come before the instance for this sweep: greater weight first, ties by name.
/// The instance itself need not be listed.
std::size_t rank(std::uint64_t run, std::uint64_t sweep, std::string_view instance,
                 const std::vector<std::string>& members);

/// What odometry says of itself.
struct Progress {
  std::uint64_t run = 0;
  /// sweeps below are done
  std::uint64_t next_sweep = 0;
  /// one more than the highest sweep it has received; what lies below and is not missing is there
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
  /// A sweep has come, each once. What is held comes out of due() later.
  Share take(const SweepToShare& sweep, std::int64_t now_ns);
  /// Whether this member is the first for the sweep.
  bool first(std::uint64_t run, std::uint64_t sweep) const;

  /// The other members; the own name may be among them.
  void set_members(std::vector<std::string> members);
  void set_progress(Progress progress);

  struct Due {
    std::uint64_t run, sweep;
    /// false: another has done it
    bool compute;
  };
  /// Held sweeps whose case is settled, in order; they are held no longer.
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
