#include "graph/loop_graph.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>

#include "graph/loop_graph_state.hpp"

namespace zloam::graph {
namespace {

// A smaller displacement is rounding, not a revision.
constexpr double kUnmoved_m = 1e-6;
// Added to the covariance of the motion between two submaps, one sigma: none is smaller.
constexpr double kLeast_m = 1e-3, kLeast_rad = 1e-4;

/// The points within this range, in the axes of the map.
std::vector<Eigen::Vector3f> points_near(const Submap& submap, double reach_m) {
  const Eigen::Matrix3f R = submap.T_map_submap.linear().cast<float>();
  const auto reach = static_cast<float>(reach_m);
  std::vector<Eigen::Vector3f> points;
  points.reserve(submap.points.size());
  for (const MapPoint& p : submap.points) {
    const Eigen::Vector3f at(p.x, p.y, p.z);
    if (at.squaredNorm() < reach * reach) points.emplace_back(R * at);
  }
  return points;
}

Between factor_of(const Loop& loop) {
  return {loop.from, loop.to, loop.T_from_to, loop.covariance, !loop.forced};
}

}  // namespace

const char* verdict_name(Verdict verdict) {
  constexpr std::array kNames = {"accepted",   "alone",      "little overlap", "weak",
                                 "not unique", "impossible", "taken back",     "removed"};
  return kNames.at(static_cast<std::size_t>(verdict));
}

void LoopGraph::State::add_node(const Submap& submap, std::size_t session) {
  const std::vector<Eigen::Vector3f> points = points_near(submap, config.verify.reach_m);
  Place place{Surfaces(points), place_features(place_image(points, config.place), config.place)};
  place.T_place_submap.linear() = submap.T_map_submap.linear();
  place.T_map_place.translation() = submap.T_map_submap.translation();
  Node node{
      session,          submap.sweep, submap.instant_ns, submap.T_map_submap, submap.T_map_submap,
      submap.connected, submap.step_m};
  while (sessions.size() <= session) {
    frames.push_back(sessions.size());
    sessions.emplace_back();
  }
  place.T_world_place = place.T_map_place;
  if (std::vector<std::size_t>& own = sessions[session]; !own.empty()) {
    const Place& before = places[own.back()];
    Between step;
    step.from = own.back();
    step.to = nodes.size();
    step.T_from_to = before.T_map_place.inverse() * place.T_map_place;
    // If submaps between the two were missed, or a drive begins with this one, which names itself
    // as the one before, the covariance of the motion between them is unknown.
    const bool missed =
        submap.before_sweep != nodes[step.from].sweep || submap.before_sweep == submap.sweep;
    if (missed) node.connected = false;
    step.covariance = carried(submap.step_covariance, place.T_place_submap) +
                      diagonal_covariance(kLeast_m, kLeast_rad);
    if (missed) {
      const double way_m = step.T_from_to.translation().norm();
      step.covariance += diagonal_covariance(3.0 * config.drift_share * way_m,
                                             3.0 * config.drift_rad_per_m * way_m);
      node.way_m = way_m;
    }
    chain.push_back(step);
    place.T_world_place = before.T_world_place * step.T_from_to;
    node.way_m += nodes[step.from].way_m;
  }
  sessions[session].push_back(nodes.size());
  node.T_world_submap = place.T_world_place * place.T_place_submap;
  nodes.push_back(node);
  places.push_back(std::move(place));
}

std::vector<Between> LoopGraph::State::factors(bool with_drift) const {
  std::vector<Between> all = chain;
  if (with_drift) {
    for (Between& step : all) {
      const double way_m = nodes[step.to].way_m - nodes[step.from].way_m;
      step.covariance +=
          diagonal_covariance(config.drift_share * way_m, config.drift_rad_per_m * way_m);
    }
  }
  for (const Loop& loop : loops) {
    if (loop.verdict != Verdict::kAccepted) continue;
    all.push_back(factor_of(loop));
  }
  return all;
}

// Relative poses of sessions according to the loops in force between them.
std::vector<Between> LoopGraph::State::session_links() const {
  std::vector<Between> links;
  for (const Loop& loop : loops) {
    Between link;
    link.from = nodes[loop.from].session;
    link.to = nodes[loop.to].session;
    if (loop.verdict != Verdict::kAccepted || link.from == link.to) continue;
    const Pose& T_map_to = places[loop.to].T_map_place;
    link.T_from_to = places[loop.from].T_map_place * loop.T_from_to * T_map_to.inverse();
    link.covariance = carried(loop.covariance, T_map_to);
    link.robust = true;
    links.push_back(link);
  }
  return links;
}

// The poses of mapping, with sessions that loops connect moved into one frame.
LoopGraph::State::Aligned LoopGraph::State::aligned() const {
  Aligned out;
  std::vector<Pose> T_world_map(sessions.size(), Pose::Identity());
  for (std::size_t i = 0; i < sessions.size(); ++i) out.frames.push_back(i);
  const std::vector<Between> links = session_links();
  for (const Between& link : links) {
    const std::size_t a = out.frames[link.from], b = out.frames[link.to];
    if (a == b) continue;
    Pose T_a_b = T_world_map[link.from] * link.T_from_to * T_world_map[link.to].inverse();
    if (b < a) T_a_b = T_a_b.inverse();
    // All sessions in the later one's frame move with it.
    for (std::size_t i = 0; i < sessions.size(); ++i) {
      if (out.frames[i] != std::max(a, b)) continue;
      T_world_map[i] = T_a_b * T_world_map[i];
      out.frames[i] = std::min(a, b);
    }
  }
  if (!links.empty()) {
    const Optimised laid = optimised(T_world_map, links);
    if (laid.converged) T_world_map = laid.poses;
  }
  for (std::size_t i = 0; i < places.size(); ++i) {
    const std::size_t session = nodes[i].session;
    const Pose& T_map_place = places[i].T_map_place;
    const bool moved = out.frames[session] != session;
    out.poses.push_back(moved ? T_world_map[session] * T_map_place : T_map_place);
  }
  return out;
}

// Mapping may have closed the loops by itself, by matching to what it saw on the first visit. The
// loops would then only add their own errors to its poses.
bool LoopGraph::State::contradicts(const std::vector<Pose>& poses) const {
  double sum = 0.0;
  std::size_t count = 0;
  for (const Loop& loop : loops) {
    if (loop.verdict != Verdict::kAccepted) continue;
    const double off = chi2(factor_of(loop), poses[loop.from], poses[loop.to]);
    if (off > config.most_chi2) return true;
    sum += off;
    ++count;
  }
  return sum > 6.0 * static_cast<double>(count);
}

// The loop in force that contradicts the poses most, if one does.
Loop* LoopGraph::State::contradiction(const std::vector<Pose>& poses) {
  Loop* worst = nullptr;
  double worst_chi2 = config.most_chi2;
  for (Loop& loop : loops) {
    if (loop.verdict != Verdict::kAccepted || loop.forced) continue;
    const double off = chi2(factor_of(loop), poses[loop.from], poses[loop.to]);
    if (off > worst_chi2) worst = &loop, worst_chi2 = off;
  }
  return worst;
}

// Whether a node comes after the last loop in force of its session: no loop tells anything of its
// motion since the node before.
std::vector<bool> LoopGraph::State::behind_the_loops() const {
  constexpr std::size_t kNone = std::numeric_limits<std::size_t>::max();
  std::vector<std::size_t> last(sessions.size(), kNone);
  for (const Loop& loop : loops) {
    if (loop.verdict != Verdict::kAccepted) continue;
    for (const std::size_t end : {loop.from, loop.to}) {
      std::size_t& of_session = last[nodes[end].session];
      of_session = of_session == kNone ? end : std::max(of_session, end);
    }
  }
  std::vector<bool> behind;
  for (std::size_t i = 0; i < nodes.size(); ++i) {
    const std::size_t end = last[nodes[i].session];
    behind.push_back(end != kNone && i > end);
  }
  return behind;
}

// Nodes behind the loops follow the one before and are no part of the fit, so that the poses are
// the same to the byte whenever it is made.
Optimised LoopGraph::State::fitted_to_loops(const std::vector<Pose>& start) const {
  const std::vector<bool> behind = behind_the_loops();
  std::vector<Between> fit = factors(false);
  std::erase_if(fit, [&](const Between& factor) { return behind[factor.to]; });
  Optimised result = optimised(start, fit);
  for (const Between& step : chain) {
    if (behind[step.to]) result.poses[step.to] = result.poses[step.from] * step.T_from_to;
  }
  return result;
}

// Starts from mapping's poses each time, so that the result depends only on the loops in force.
// True: the poses have changed.
bool LoopGraph::State::optimise(std::vector<Loop>& decided) {
  Aligned start = aligned();
  std::vector<Pose> poses = start.poses;
  fitted = true;
  while (contradicts(start.poses)) {
    const Optimised result = fitted_to_loops(start.poses);
    fitted = result.converged;
    if (!fitted) return false;
    chi2_before = result.chi2_before;
    chi2_after = result.chi2_after;
    poses = result.poses;
    Loop* worst = contradiction(poses);
    if (!worst) break;
    worst->verdict = Verdict::kTakenBack;
    decided.push_back(*worst);
    part(decided);
    start = aligned();
    poses = start.poses;
  }
  frames = start.frames;
  return move_to(poses);
}

std::vector<Pose> LoopGraph::State::world() const {
  std::vector<Pose> poses;
  for (const Place& place : places) poses.push_back(place.T_world_place);
  return poses;
}

bool LoopGraph::State::move_to(const std::vector<Pose>& poses) {
  last_move_m = 0.0;
  for (std::size_t i = 0; i < places.size(); ++i) {
    Place& place = places[i];
    const Eigen::Vector3d move = poses[i].translation() - place.T_world_place.translation();
    last_move_m = std::max(last_move_m, move.norm());
    place.T_world_place = poses[i];
    nodes[i].T_world_submap = poses[i] * place.T_place_submap;
  }
  if (last_move_m < kUnmoved_m) return false;
  ++revision;
  return true;
}

LoopGraph::LoopGraph(const GraphConfig& config) : state_(std::make_unique<State>(config)) {}
LoopGraph::~LoopGraph() = default;
LoopGraph::LoopGraph(LoopGraph&&) noexcept = default;
LoopGraph& LoopGraph::operator=(LoopGraph&&) noexcept = default;

// Converts a loop between places (internal) into one between submaps (public).
Loop LoopGraph::State::of_submaps(Loop loop) const {
  const Pose& from = places[loop.from].T_place_submap;
  const Pose& to = places[loop.to].T_place_submap;
  loop.T_from_to = from.inverse() * loop.T_from_to * to;
  loop.covariance = carried(loop.covariance, to.inverse());
  return loop;
}

// Decides on the best loop of the newest submap with connected submaps, and on that with submaps of
// unknown relative pose. True: loops have come into force.
bool LoopGraph::State::decide(std::size_t to, std::vector<Loop>& decided) {
  const auto known = known_from(to);
  bool accepted = false;
  for (const auto& from : {candidates(to, known), strange_candidates(to, known)}) {
    const auto best = best_of(to, from, known, decided);
    if (!best) continue;
    if (best->verdict != Verdict::kAlone) {
      decided.push_back(*best);
    } else {
      accepted |= joins_strangers(*best) ? join(*best, decided) : confirm(*best, decided);
    }
  }
  return accepted;
}

Update LoopGraph::add(const Submap& submap, std::size_t session) {
  State& s = *state_;
  s.add_node(submap, session);
  Update update;
  if (s.decide(s.nodes.size() - 1, update.loops)) update.revised = s.optimise(update.loops);
  for (Loop& loop : update.loops) loop = s.of_submaps(loop);
  return update;
}

// Loops that contradicted only a removed one are in force again; the fit takes back those that
// contradict others too. True: the poses have changed.
bool LoopGraph::State::try_again() {
  const std::vector<Loop> left = loops;
  for (Loop& loop : loops) {
    if (loop.verdict == Verdict::kTakenBack) loop.verdict = Verdict::kAccepted;
  }
  std::vector<Loop> ignored;
  part(ignored);
  const bool revised = optimise(ignored);
  if (fitted) return revised;
  // Without a fit the poses would still be those with the removed loop.
  loops = left;
  part(ignored);
  return optimise(ignored);
}

std::optional<Update> LoopGraph::remove(std::size_t from, std::size_t to) {
  State& s = *state_;
  const auto removed = std::ranges::find_if(s.loops, [&](const Loop& loop) {
    return loop.from == from && loop.to == to && loop.verdict == Verdict::kAccepted;
  });
  if (removed == s.loops.end()) return std::nullopt;
  const std::vector<Loop> before = s.loops;
  removed->verdict = Verdict::kRemoved;
  Update update;
  update.revised = s.try_again();
  for (std::size_t i = 0; i < before.size(); ++i) {
    if (s.loops[i].verdict == before[i].verdict) continue;
    update.loops.push_back(s.of_submaps(s.loops[i]));
  }
  return update;
}

const std::vector<Node>& LoopGraph::nodes() const { return state_->nodes; }
std::vector<Loop> LoopGraph::loops() const {
  std::vector<Loop> out;
  for (const Loop& loop : state_->loops) out.push_back(state_->of_submaps(loop));
  return out;
}
std::size_t LoopGraph::loops_in_force() const {
  return static_cast<std::size_t>(
      std::count_if(state_->loops.begin(), state_->loops.end(),
                    [](const Loop& loop) { return loop.verdict == Verdict::kAccepted; }));
}
std::vector<Loop> LoopGraph::in_force(std::uint64_t from_sweep, std::uint64_t to_sweep) const {
  std::vector<Loop> as_named, reversed;
  for (const Loop& loop : state_->loops) {
    if (loop.verdict != Verdict::kAccepted) continue;
    const std::pair ends(state_->nodes[loop.from].sweep, state_->nodes[loop.to].sweep);
    if (ends == std::pair(from_sweep, to_sweep)) as_named.push_back(state_->of_submaps(loop));
    if (ends == std::pair(to_sweep, from_sweep)) reversed.push_back(state_->of_submaps(loop));
  }
  return as_named.empty() ? reversed : as_named;
}
double LoopGraph::last_move_m() const { return state_->last_move_m; }
bool LoopGraph::fitted() const { return state_->fitted; }
std::uint32_t LoopGraph::revision() const { return state_->revision; }
double LoopGraph::chi2_before() const { return state_->chi2_before; }
double LoopGraph::chi2_after() const { return state_->chi2_after; }

std::size_t LoopGraph::frame_of(std::size_t session) const { return state_->frames.at(session); }

std::vector<Between> LoopGraph::factors() const {
  std::vector<Between> all = state_->factors(false);
  for (Between& factor : all) {
    const Pose& from = state_->places[factor.from].T_place_submap;
    const Pose& to = state_->places[factor.to].T_place_submap;
    factor.T_from_to = from.inverse() * factor.T_from_to * to;
    factor.covariance = carried(factor.covariance, to.inverse());
  }
  return all;
}

Pose LoopGraph::corrected(std::int64_t instant_ns, const Pose& T_map_base,
                          std::size_t session) const {
  if (session >= state_->sessions.size()) return T_map_base;
  const std::vector<std::size_t>& own = state_->sessions[session];
  const std::vector<Node>& nodes = state_->nodes;
  const auto correction = [&](std::size_t i) {
    return nodes[i].T_world_submap * nodes[i].T_map_submap.inverse();
  };
  const auto after = std::upper_bound(
      own.begin(), own.end(), instant_ns,
      [&](std::int64_t instant, std::size_t i) { return instant < nodes[i].instant_ns; });
  if (own.empty()) return T_map_base;
  if (after == own.begin()) return correction(own.front()) * T_map_base;
  if (after == own.end()) return correction(own.back()) * T_map_base;
  const std::size_t before = *(after - 1);
  const double share = static_cast<double>(instant_ns - nodes[before].instant_ns) /
                       static_cast<double>(nodes[*after].instant_ns - nodes[before].instant_ns);
  // Both neighbouring submaps give a corrected pose; their difference is interpolated in time.
  const Pose by_first = correction(before) * T_map_base;
  const Pose by_second = correction(*after) * T_map_base;
  return by_first * exp_se3(share * log_se3(by_first.inverse() * by_second));
}

}  // namespace zloam::graph
