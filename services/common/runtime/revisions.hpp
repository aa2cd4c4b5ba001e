#pragma once
// Which revision of a stage's configuration is in force at which sweep (docs/protocol.md, section
// 13). Without clock, threads or transport: every instance that knows the same revisions and runs
// says the same.

#include <cstdint>
#include <set>
#include <string>
#include <tuple>
#include <vector>

#include "common/messages/build.hpp"

namespace zloam::runtime {

using Revision = ConfigRevisionFields;

class RevisionSchedule {
 public:
  /// A run begins: what was changed in other runs before is in force in the whole of it, what was
  /// said of no run belongs to it.
  void begin_run(std::uint64_t run);

  /// False: known already. Of two that two instances issued under one number the one of the
  /// greater instance counts, everywhere.
  bool add(Revision revision);
  /// It never was, and is not added again.
  void withdraw(std::uint32_t rev);

  /// Null: as the stage was started.
  const Revision* in_force(std::uint64_t run, std::uint64_t sweep) const;
  std::uint32_t rev_at(std::uint64_t run, std::uint64_t sweep) const;
  /// The one with the greatest number, in force or to come.
  const Revision* newest() const;
  /// Ascending.
  const std::vector<Revision>& all() const { return revisions_; }

 private:
  bool applies(const Revision& revision, std::uint64_t run, std::uint64_t sweep) const;

  std::vector<Revision> revisions_;
  /// (rev, by, at_ns): an instance that was started again, under its name too, may issue the number
  std::set<std::tuple<std::uint32_t, std::string, std::int64_t>> withdrawn_;
  /// 0: none yet
  std::uint64_t run_ = 0;
  /// revisions up to this number, of other runs than run_, were known when it began
  std::uint32_t known_at_begin_ = 0;
};

}  // namespace zloam::runtime
