#include "graph/loop_graph.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "graph/expectation.hpp"

namespace zloam::graph {
namespace {

// Chi-squared with two degrees of freedom, 99.9 %: how far off a place may be in the plane.
constexpr double kPlaneChi2 = 13.8;
// Beside that: what matching can bridge, m.
constexpr double kReach_m = 8.0;
// Less uncertain than that is what matching begins with anyway.
constexpr double kSure_m = 1.0;
// Two places that differ by less are one.
constexpr double kSame_m = 1.5, kSame_rad = 0.15;
constexpr double kSameGuess_m = 4.0;
// Rounding, and no other poses.
constexpr double kUnmoved_m = 1e-6;
// Loops that must agree on where two sessions lie to each other, where nothing else tells it; and
// places that are verified for it.
constexpr std::size_t kJoining = 3, kStrangeCandidates = 8;
// Of the motion between two submaps, one sigma: no covariance is smaller.
constexpr double kLeast_m = 1e-3, kLeast_rad = 1e-4;

Matrix6 diagonal(double sigma_m, double sigma_rad) {
  Matrix6 out = Matrix6::Zero();
  out.diagonal().head<3>().setConstant(sigma_m * sigma_m);
  out.diagonal().tail<3>().setConstant(sigma_rad * sigma_rad);
  return out;
}

Pose turned_by(double yaw_rad) {
  Pose out = Pose::Identity();
  out.linear() = Eigen::AngleAxisd(yaw_rad, Eigen::Vector3d::UnitZ()).toRotationMatrix();
  return out;
}

bool is_same(const Pose& a, const Pose& b) {
  const Vector6 off = log_se3(a.inverse() * b);
  return off.head<3>().norm() < kSame_m && off.tail<3>().norm() < kSame_rad;
}

/// In the axes of the map.
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
  return {loop.from, loop.to, loop.T_from_to, loop.covariance, true};
}

}  // namespace

const char* verdict_name(Verdict verdict) {
  constexpr std::array kNames = {"accepted",   "alone",      "little overlap", "weak",
                                 "not unique", "impossible", "taken back",     "removed"};
  return kNames.at(static_cast<std::size_t>(verdict));
}

struct LoopGraph::State {
  explicit State(const GraphConfig& c) : config(c) {}

  // What a node needs to find and verify loops; place frame.
  struct Place {
    Surfaces surfaces;
    PlaceFeatures features;
    Pose T_map_place = Pose::Identity();
    Pose T_world_place = Pose::Identity();
    Pose T_place_submap = Pose::Identity();
  };
  struct Aligned {
    std::vector<Pose> poses;
    // Of each session, as State::frames.
    std::vector<std::size_t> frames;
  };
  struct Candidate {
    std::size_t from;
    Pose guess;
    std::size_t agreeing;
  };

  void add_node(const Submap& submap, std::size_t session);
  std::vector<Candidate> candidates(std::size_t to,
                                    const std::vector<std::optional<Matrix6>>& known) const;
  std::vector<Candidate> strange_candidates(std::size_t to,
                                            const std::vector<std::optional<Matrix6>>& known) const;
  std::optional<Candidate> seen_from(std::size_t from, std::size_t to) const;
  static void likeliest_first(std::vector<Candidate>& seen) {
    std::stable_sort(seen.begin(), seen.end(), [](const Candidate& a, const Candidate& b) {
      return a.agreeing > b.agreeing;
    });
  }
  std::vector<Candidate> distinct(const std::vector<Candidate>& all, std::size_t most) const;
  std::optional<Loop> best_of(std::size_t to, const std::vector<Candidate>& candidates,
                              const std::vector<std::optional<Matrix6>>& known,
                              std::vector<Loop>& looked_at);
  bool agrees(const Loop& a, const Loop& b) const;
  bool bears_out(const Loop& a, const Loop& b) const;
  bool confirm(const Loop& loop, std::vector<Loop>& decided);
  bool join(const Loop& loop, std::vector<Loop>& decided);
  bool settle(Loop loop, bool accepted, const std::vector<Loop*>& with, std::vector<Loop>& decided);
  bool joins_strangers(const Loop& loop) const;
  bool decide(std::size_t to, std::vector<Loop>& decided);
  Loop of_submaps(Loop loop) const;
  std::vector<Between> session_links() const;
  Aligned aligned() const;
  bool contradicts(const std::vector<Pose>& poses) const;
  Loop* contradiction(const std::vector<Pose>& poses);
  bool optimise(std::vector<Loop>& decided);
  bool move_to(const std::vector<Pose>& poses);
  std::vector<Between> factors(bool with_drift) const;

  GraphConfig config;
  std::vector<Node> nodes;
  std::vector<Place> places;
  // Nodes of each session, and the session in whose frame it lies.
  std::vector<std::vector<std::size_t>> sessions;
  std::vector<std::size_t> frames;
  // From each node to the next one of its session.
  std::vector<Between> chain;
  std::vector<Loop> loops;
  std::uint32_t revision = 0;
  bool fitted = true;
  double chi2_before = 0.0, chi2_after = 0.0, last_move_m = 0.0;
};

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
    // Of what was missed between the two nothing is known but where both are.
    const bool missed = submap.before_sweep != nodes[step.from].sweep;
    if (missed) node.connected = false;
    step.covariance =
        carried(submap.step_covariance, place.T_place_submap) + diagonal(kLeast_m, kLeast_rad);
    if (missed) {
      const double way_m = step.T_from_to.translation().norm();
      step.covariance +=
          diagonal(3.0 * config.drift_share * way_m, 3.0 * config.drift_rad_per_m * way_m);
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
      step.covariance += diagonal(config.drift_share * way_m, config.drift_rad_per_m * way_m);
    }
  }
  for (const Loop& loop : loops) {
    if (loop.verdict != Verdict::kAccepted) continue;
    all.push_back(factor_of(loop));
  }
  return all;
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
    // Where it is known well enough, what is seen need not be asked for it.
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

// By what both look like from above.
std::optional<LoopGraph::State::Candidate> LoopGraph::State::seen_from(std::size_t from,
                                                                       std::size_t to) const {
  const PlaceMatch match = match_places(places[from].features, places[to].features, config.place);
  if (match.agreeing == 0) return std::nullopt;
  Pose guess = turned_by(match.yaw_rad);
  guess.translation() << match.shift_m, 0.0;
  return Candidate{from, guess, match.agreeing};
}

// Of the sessions of which nobody knows where they lie.
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

// Of those that say the same of where the newest submap is the first one.
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

std::optional<Loop> LoopGraph::State::best_of(std::size_t to,
                                              const std::vector<Candidate>& candidates,
                                              const std::vector<std::optional<Matrix6>>& known,
                                              std::vector<Loop>& looked_at) {
  std::vector<Loop> all;
  for (const Candidate& candidate : candidates) {
    const Overlap overlap = matched(places[candidate.from].surfaces, places[to].surfaces,
                                    candidate.guess, config.verify);
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
    all.push_back(loop);
  }
  const Loop* best = nullptr;
  for (const Loop& loop : all) {
    if (loop.verdict == Verdict::kAlone && (!best || loop.overlap > best->overlap)) best = &loop;
  }
  std::optional<Loop> out;
  if (best) out = *best;
  for (Loop& loop : all) {
    if (&loop == best) continue;
    if (best && loop.verdict == Verdict::kAlone) {
      const Pose here = places[best->from].T_world_place * best->T_from_to;
      const Pose there = places[loop.from].T_world_place * loop.T_from_to;
      const bool rival =
          !is_same(here, there) && loop.overlap > config.verify.unique_share * best->overlap;
      if (rival) out->verdict = Verdict::kNotUnique;
      continue;
    }
    looked_at.push_back(loop);
  }
  return out;
}

// Near by, along the ways between their ends.
bool LoopGraph::State::bears_out(const Loop& a, const Loop& b) const {
  const auto is_near = [&](std::size_t i, std::size_t j) {
    return nodes[i].session == nodes[j].session &&
           std::abs(nodes[i].way_m - nodes[j].way_m) <= config.confirm_way_m;
  };
  return is_near(a.to, b.to) && is_near(a.from, b.from) && agrees(a, b);
}

// Around the ring of both loops and the ways between their ends, which are of the same sessions.
bool LoopGraph::State::agrees(const Loop& a, const Loop& b) const {
  if (a.to == b.to) return false;
  const auto way_m = [&](std::size_t i, std::size_t j) {
    return std::abs(nodes[i].way_m - nodes[j].way_m);
  };
  const auto along = [&](std::size_t i, std::size_t j) {
    return places[i].T_map_place.inverse() * places[j].T_map_place;
  };
  const Pose by_b = along(a.from, b.from) * b.T_from_to * along(b.to, a.to);
  const double drift_m = way_m(a.to, b.to) + way_m(a.from, b.from);
  const Matrix6 covariance =
      a.covariance + carried(b.covariance, along(a.to, b.to)) +
      diagonal(config.drift_share * drift_m, config.drift_rad_per_m * drift_m);
  return squared_distance(by_b, a.T_from_to, covariance) < config.most_chi2;
}

bool LoopGraph::State::confirm(const Loop& loop, std::vector<Loop>& decided) {
  std::vector<Loop*> bearing;
  for (Loop& other : loops) {
    const bool counts = other.verdict == Verdict::kAccepted || other.verdict == Verdict::kAlone;
    if (counts && bears_out(loop, other)) bearing.push_back(&other);
  }
  return settle(loop, !bearing.empty(), bearing, decided);
}

bool LoopGraph::State::joins_strangers(const Loop& loop) const {
  return frames[nodes[loop.from].session] != frames[nodes[loop.to].session];
}

// Nothing but loops tells where two sessions lie to each other: more of them must say the same, and
// more than contradict it.
bool LoopGraph::State::join(const Loop& loop, std::vector<Loop>& decided) {
  std::vector<Loop*> agreeing;
  std::size_t others = 0;
  for (Loop& other : loops) {
    const bool same_sessions = nodes[other.from].session == nodes[loop.from].session &&
                               nodes[other.to].session == nodes[loop.to].session;
    if (other.verdict != Verdict::kAlone || !same_sessions) continue;
    if (agrees(loop, other)) {
      agreeing.push_back(&other);
    } else {
      ++others;
    }
  }
  const bool accepted = agreeing.size() + 1 >= kJoining && agreeing.size() + 1 > others;
  return settle(loop, accepted, agreeing, decided);
}

// A new loop, and those that it is accepted with.
bool LoopGraph::State::settle(Loop loop, bool accepted, const std::vector<Loop*>& with,
                              std::vector<Loop>& decided) {
  if (accepted) {
    loop.verdict = Verdict::kAccepted;
    for (Loop* other : with) {
      if (other->verdict == Verdict::kAccepted) continue;
      other->verdict = Verdict::kAccepted;
      decided.push_back(*other);
    }
  }
  loops.push_back(loop);
  decided.push_back(loop);
  return accepted;
}

// What the loops in force say of where two sessions lie to each other.
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

// Where mapping had all, with the sessions laid upon each other where loops say how.
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
    // All that lies in the later one's frame goes along.
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

// Mapping may have closed the loops by itself, by matching to what it saw the first time. Then they
// would only add their own errors to its poses.
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
    if (loop.verdict != Verdict::kAccepted) continue;
    const double off = chi2(factor_of(loop), poses[loop.from], poses[loop.to]);
    if (off > worst_chi2) worst = &loop, worst_chi2 = off;
  }
  return worst;
}

// From mapping's poses each time: what comes out is a matter of the loops in force alone. True: the
// poses have changed.
bool LoopGraph::State::optimise(std::vector<Loop>& decided) {
  Aligned start = aligned();
  std::vector<Pose> poses = start.poses;
  fitted = true;
  while (contradicts(start.poses)) {
    const Optimised result = optimised(start.poses, factors(false));
    fitted = result.converged;
    if (!fitted) return false;
    chi2_before = result.chi2_before;
    chi2_after = result.chi2_after;
    poses = result.poses;
    Loop* worst = contradiction(poses);
    if (!worst) break;
    worst->verdict = Verdict::kTakenBack;
    decided.push_back(*worst);
    start = aligned();
    poses = start.poses;
  }
  frames = start.frames;
  return move_to(poses);
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

// Of places inside, of submaps outside.
Loop LoopGraph::State::of_submaps(Loop loop) const {
  const Pose& from = places[loop.from].T_place_submap;
  const Pose& to = places[loop.to].T_place_submap;
  loop.T_from_to = from.inverse() * loop.T_from_to * to;
  loop.covariance = carried(loop.covariance, to.inverse());
  return loop;
}

// The loop that the newest submap closes with what it is known to lie near, and with what may lie
// anywhere. True: loops in force have come.
bool LoopGraph::State::decide(std::size_t to, std::vector<Loop>& decided) {
  std::vector<Pose> world;
  for (const Place& place : places) world.push_back(place.T_world_place);
  const auto known = uncertainties(to, world, factors(true));
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

bool LoopGraph::remove(std::size_t from, std::size_t to) {
  State& s = *state_;
  for (Loop& loop : s.loops) {
    if (loop.from != from || loop.to != to || loop.verdict != Verdict::kAccepted) continue;
    loop.verdict = Verdict::kRemoved;
    std::vector<Loop> ignored;
    s.optimise(ignored);
    return true;
  }
  return false;
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
  // Both ends of the stretch say where the pose is; what they differ by is spread over it.
  const Pose by_first = correction(before) * T_map_base;
  const Pose by_second = correction(*after) * T_map_base;
  return by_first * exp_se3(share * log_se3(by_first.inverse() * by_second));
}

}  // namespace zloam::graph
