// Search for loops of a new node: candidates by pose and by appearance, and the best of those that
// verification accepts.

#include <algorithm>
#include <cmath>
#include <numbers>

#include "graph/expectation.hpp"
#include "graph/loop_graph_state.hpp"

namespace zloam::graph {
namespace {

// Maximum horizontal distance of a candidate: chi-squared with two degrees of freedom, 99.9 %.
constexpr double kPlaneChi2 = 13.8;
// Added to that distance: error from which matching converges, m.
constexpr double kReach_m = 8.0;
// With a smaller sigma the expected pose itself is a good enough start of the matching.
constexpr double kSure_m = 1.0;
// Poses that differ by less are the same place.
constexpr double kSame_m = 1.5, kSame_rad = 0.15;
constexpr double kSameGuess_m = 4.0;
// Number of places of sessions with unknown relative pose that are verified.
constexpr std::size_t kStrangeCandidates = 8;

// Headings from which a submap is matched at the place of another: from half the angle between two
// of them, matching converges.
constexpr int kHeadings = 8;

Pose turned_by(double yaw_rad) {
  Pose out = Pose::Identity();
  out.linear() = Eigen::AngleAxisd(yaw_rad, Eigen::Vector3d::UnitZ()).toRotationMatrix();
  return out;
}

bool is_same(const Pose& a, const Pose& b) {
  const Vector6 off = log_se3(a.inverse() * b);
  return off.head<3>().norm() < kSame_m && off.tail<3>().norm() < kSame_rad;
}

}  // namespace

std::vector<std::optional<Matrix6>> LoopGraph::State::known_from(std::size_t to) const {
  return uncertainties(to, world(), factors(true));
}

std::vector<LoopGraph::State::Candidate> LoopGraph::State::candidates(
    std::size_t to, const std::vector<std::optional<Matrix6>>& known) const {
  std::vector<Candidate> near, seen;
  for (std::size_t from = 0; from < to; ++from) {
    const bool same_session = nodes[from].session == nodes[to].session;
    if (!known[from]) continue;
    if (same_session && nodes[to].way_m - nodes[from].way_m < config.loop_way_m) continue;
    const Pose expected = places[from].T_world_place.inverse() * places[to].T_world_place;
    const double distance_m = expected.translation().head<2>().norm();
    const double sigma_m = std::sqrt(known[from]->topLeftCorner<2, 2>().trace());
    // If the pose is known well enough, no comparison of appearance is needed.
    if (sigma_m < kSure_m) {
      if (distance_m < config.verify.radius_m / 2.0) near.push_back({from, expected, 0});
      continue;
    }
    if (distance_m > kReach_m + config.verify.radius_m + std::sqrt(kPlaneChi2) * sigma_m) continue;
    if (const auto candidate = seen_from(from, to)) seen.push_back(*candidate);
  }
  std::stable_sort(near.begin(), near.end(), [](const Candidate& a, const Candidate& b) {
    return a.guess.translation().squaredNorm() < b.guess.translation().squaredNorm();
  });
  likeliest_first(seen);
  near.insert(near.end(), seen.begin(), seen.end());
  return distinct(near, config.candidates);
}

// Candidate by comparing both places as seen from above.
std::optional<LoopGraph::State::Candidate> LoopGraph::State::seen_from(std::size_t from,
                                                                       std::size_t to) const {
  const PlaceMatch match = match_places(places[from].features, places[to].features, config.place);
  if (match.agreeing == 0) return std::nullopt;
  Pose guess = turned_by(match.yaw_rad);
  guess.translation() << match.shift_m, 0.0;
  return Candidate{from, guess, match.agreeing};
}

// Where the newer of two submaps that a user names may lie in the older one: as the graph has it, as
// both look from above, and at the same place.
std::vector<LoopGraph::State::Candidate> LoopGraph::State::guesses(std::size_t from,
                                                                   std::size_t to) const {
  std::vector<Candidate> out;
  out.push_back({from, places[from].T_world_place.inverse() * places[to].T_world_place, 0});
  if (const auto seen = seen_from(from, to)) out.push_back(*seen);
  for (int i = 0; i < kHeadings; ++i) {
    out.push_back({from, turned_by(2.0 * std::numbers::pi * i / kHeadings), 0});
  }
  return out;
}

// Candidates in sessions whose pose relative to this one is unknown.
std::vector<LoopGraph::State::Candidate> LoopGraph::State::strange_candidates(
    std::size_t to, const std::vector<std::optional<Matrix6>>& known) const {
  std::vector<Candidate> seen;
  for (std::size_t from = 0; from < to; ++from) {
    if (known[from]) continue;
    if (const auto candidate = seen_from(from, to)) seen.push_back(*candidate);
  }
  likeliest_first(seen);
  return distinct(seen, kStrangeCandidates);
}

// Of candidates that put the newest submap at the same place, only the first one.
std::vector<LoopGraph::State::Candidate> LoopGraph::State::distinct(
    const std::vector<Candidate>& all, std::size_t most) const {
  const auto frame = [&](const Candidate& c) { return frames[nodes[c.from].session]; };
  std::vector<Candidate> out;
  for (const Candidate& candidate : all) {
    const Pose here = places[candidate.from].T_world_place * candidate.guess;
    const bool known = std::any_of(out.begin(), out.end(), [&](const Candidate& other) {
      const Pose there = places[other.from].T_world_place * other.guess;
      return frame(candidate) == frame(other) &&
             (here.translation() - there.translation()).head<2>().norm() < kSameGuess_m;
    });
    if (!known) out.push_back(candidate);
    if (out.size() == most) break;
  }
  return out;
}

Loop LoopGraph::State::verified(std::size_t to, const Candidate& candidate,
                                const std::vector<std::optional<Matrix6>>& known) const {
  const Overlap overlap =
      matched(places[candidate.from].surfaces, places[to].surfaces, candidate.guess, config.verify);
  Loop loop;
  loop.from = candidate.from;
  loop.to = to;
  loop.T_from_to = overlap.T_a_b;
  loop.covariance = overlap.covariance;
  loop.overlap = overlap.share;
  loop.residual_m = overlap.residual_m;
  if (const auto& uncertainty = known[loop.from]) {
    const Pose expected = places[loop.from].T_world_place.inverse() * places[to].T_world_place;
    loop.chi2 = squared_distance(expected, loop.T_from_to, *uncertainty + loop.covariance);
  }
  loop.verdict = loop.overlap < config.verify.overlap                  ? Verdict::kLittleOverlap
                 : overlap.weakest_share < config.verify.weakest_share ? Verdict::kWeak
                 : !(loop.chi2 < config.most_chi2)                     ? Verdict::kImpossible
                                                                       : Verdict::kAlone;
  return loop;
}

// Whether another verified loop puts the newer submap at another place, and is nearly as good.
bool LoopGraph::State::rivals(const Loop& loop, const Loop& other) const {
  if (other.verdict != Verdict::kAlone) return false;
  const Pose here = places[loop.from].T_world_place * loop.T_from_to;
  const Pose there = places[other.from].T_world_place * other.T_from_to;
  return !is_same(here, there) && other.overlap > config.verify.unique_share * loop.overlap;
}

std::optional<Loop> LoopGraph::State::best_of(std::size_t to,
                                              const std::vector<Candidate>& candidates,
                                              const std::vector<std::optional<Matrix6>>& known,
                                              std::vector<Loop>& looked_at) const {
  std::vector<Loop> all;
  for (const Candidate& candidate : candidates) all.push_back(verified(to, candidate, known));
  const Loop* best = nullptr;
  for (const Loop& loop : all) {
    if (loop.verdict == Verdict::kAlone && (!best || loop.overlap > best->overlap)) best = &loop;
  }
  std::optional<Loop> out;
  if (best) out = *best;
  for (const Loop& loop : all) {
    if (&loop == best) continue;
    if (best && loop.verdict == Verdict::kAlone) {
      if (rivals(*best, loop)) out->verdict = Verdict::kNotUnique;
      continue;
    }
    looked_at.push_back(loop);
  }
  return out;
}

}  // namespace zloam::graph
