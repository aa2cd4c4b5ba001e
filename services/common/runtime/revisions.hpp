#pragma once
// Which revision of a stage's configuration is in force at which sweep (docs/protocol.md, section
// 13). Without clock, threads or transport: all instances that know the same revisions and runs
// give the same result. Times are of any monotonic clock, ns.

#include <cstdint>
#include <map>
#include <string>
#include <tuple>
#include <vector>

#include "common/messages/build.hpp"

namespace zloam::runtime {

using Revision = ConfigRevisionFields;

class RevisionSchedule {
 public:
  static constexpr std::int64_t kWithdrawn_ns = 10'000'000'000;

  /// A run begins: changes made in earlier runs are in force in all of it; changes made outside a
  /// run belong to it.
  void begin_run(std::uint64_t run);

  /// False: known already. If two instances issued the same number, the revision of the greater
  /// instance counts, everywhere.
  bool add(Revision revision);
  /// Removes the revision as if it never existed.
  void withdraw(std::uint32_t rev, std::int64_t now_ns);
  /// It was withdrawn less than kWithdrawn_ns ago. By then all who saw its stage die have withdrawn
  /// it: if a process still keeps it, links were lost here and not lives.
  bool is_withdrawn(const Revision& revision, std::int64_t now_ns) const;

  /// Null: the configuration at the stage's start.
  const Revision* in_force(std::uint64_t run, std::uint64_t sweep) const;
  std::uint32_t rev_at(std::uint64_t run, std::uint64_t sweep) const;
  /// The revision with the greatest number, in force or to come.
  const Revision* newest() const;
  /// Ascending.
  const std::vector<Revision>& all() const { return revisions_; }

 private:
  bool applies(const Revision& revision, std::uint64_t run, std::uint64_t sweep) const;

  std::vector<Revision> revisions_;
  /// (rev, by, at_ns) -> when it was withdrawn: a restarted instance, even with the same name, may
  /// issue the number again
  std::map<std::tuple<std::uint32_t, std::string, std::int64_t>, std::int64_t> withdrawn_ns_;
  /// 0: none yet
  std::uint64_t run_ = 0;
  /// revisions up to this number, of other runs than run_, were known when it began
  std::uint32_t known_at_begin_ = 0;
};

}  // namespace zloam::runtime
