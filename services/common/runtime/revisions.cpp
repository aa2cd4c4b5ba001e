#include "common/runtime/revisions.hpp"

#include <algorithm>
#include <utility>

namespace zloam::runtime {

void RevisionSchedule::begin_run(std::uint64_t run) {
  if (run == run_) return;
  run_ = run;
  for (Revision& r : revisions_) {
    if (r.run == 0) r.run = run;
  }
  known_at_begin_ = revisions_.empty() ? 0 : revisions_.back().rev;
}

void RevisionSchedule::withdraw(std::uint32_t rev, std::int64_t now_ns) {
  std::erase_if(revisions_, [&](const Revision& r) {
    if (r.rev == rev) withdrawn_ns_.insert_or_assign({r.rev, r.by, r.at_ns}, now_ns);
    return r.rev == rev;
  });
}

bool RevisionSchedule::is_withdrawn(const Revision& revision, std::int64_t now_ns) const {
  const auto found = withdrawn_ns_.find({revision.rev, revision.by, revision.at_ns});
  return found != withdrawn_ns_.end() && now_ns - found->second < kWithdrawn_ns;
}

bool RevisionSchedule::add(Revision revision) {
  // An instance that has not seen a run yet issues revisions without one.
  if (revision.run == 0) revision.run = run_;
  const auto at =
      std::lower_bound(revisions_.begin(), revisions_.end(), revision.rev,
                       [](const Revision& r, std::uint32_t rev) { return r.rev < rev; });
  if (at == revisions_.end() || at->rev != revision.rev) {
    revisions_.insert(at, std::move(revision));
    return true;
  }
  if (at->by >= revision.by) return false;
  *at = std::move(revision);
  return true;
}

bool RevisionSchedule::applies(const Revision& revision, std::uint64_t run,
                               std::uint64_t sweep) const {
  if (revision.run == run || revision.run == 0) return sweep >= revision.from_sweep;
  // A revision of another run applies to the current run only if it was known when that began;
  // otherwise it is of a run that has not begun here yet. To a run to come all revisions apply.
  return revision.rev <= known_at_begin_ || run != run_;
}

const Revision* RevisionSchedule::in_force(std::uint64_t run, std::uint64_t sweep) const {
  const auto found = std::find_if(revisions_.rbegin(), revisions_.rend(),
                                  [&](const Revision& r) { return applies(r, run, sweep); });
  return found == revisions_.rend() ? nullptr : &*found;
}

std::uint32_t RevisionSchedule::rev_at(std::uint64_t run, std::uint64_t sweep) const {
  const Revision* revision = in_force(run, sweep);
  return revision == nullptr ? 0 : revision->rev;
}

const Revision* RevisionSchedule::newest() const {
  return revisions_.empty() ? nullptr : &revisions_.back();
}

}  // namespace zloam::runtime
