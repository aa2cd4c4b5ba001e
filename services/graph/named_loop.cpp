// A loop that a user names: the best match of the two submaps, held to the conditions of any other
// loop but the one that another loop confirms it.

#include <algorithm>
#include <tuple>
#include <utility>

#include "graph/loop_graph_state.hpp"

namespace zloam::graph {
Loop LoopGraph::State::named(std::size_t from, std::size_t to) const {
  const auto known = known_from(to);
  std::vector<Loop> all;
  for (const Candidate& guess : guesses(from, to)) all.push_back(verified(to, guess, known));
  const auto quality = [](const Loop& loop) {
    return std::pair(loop.verdict == Verdict::kAlone, loop.overlap);
  };
  Loop best = *std::ranges::max_element(all, {}, quality);
  for (const Candidate& other : candidates(to, known)) {
    if (other.from != from) all.push_back(verified(to, other, known));
  }
  const auto is_rival = [&](const Loop& other) { return rivals(best, other); };
  if (best.verdict == Verdict::kAlone && std::ranges::any_of(all, is_rival)) {
    best.verdict = Verdict::kNotUnique;
  }
  return best;
}

// False: the loop contradicts those in force, or the poses can't be fitted to it, and all is as
// before.
bool LoopGraph::State::comes_into_force(const Loop& loop, Update& update) {
  const std::vector<Pose> poses_before = world();
  const std::tuple before(loops, frames, revision, fitted, chi2_before, chi2_after, last_move_m);
  std::erase_if(loops, [&](const Loop& l) { return l.from == loop.from && l.to == loop.to; });
  loops.push_back(loop);
  std::vector<Loop> decided;
  const bool revised = optimise(decided);
  if (fitted && (loop.forced || decided.empty())) {
    update.loops = std::move(decided);
    update.revised = revised;
    return true;
  }
  move_to(poses_before);
  std::tie(loops, frames, revision, fitted, chi2_before, chi2_after, last_move_m) = before;
  return false;
}

Update LoopGraph::add_loop(std::size_t from, std::size_t to, bool forced) {
  State& s = *state_;
  Update update;
  Loop loop = s.named(from, to);
  loop.forced = forced && loop.overlap > 0.0;
  if (loop.verdict == Verdict::kAlone || loop.forced) {
    loop.verdict = Verdict::kAccepted;
    if (!s.comes_into_force(loop, update)) loop.verdict = Verdict::kTakenBack;
  }
  update.loops.push_back(loop);
  for (Loop& each : update.loops) each = s.of_submaps(each);
  return update;
}

}  // namespace zloam::graph
