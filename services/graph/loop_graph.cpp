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
  struct Candidate {
    std::size_t from;
    Pose guess;
    std::size_t agreeing;
  };

  void add_node(const Submap& submap);
  std::vector<Candidate> candidates(std::size_t to,
                                    const std::vector<std::optional<Matrix6>>& known) const;
  std::vector<Candidate> distinct(const std::vector<Candidate>& all) const;
  std::optional<Loop> best_of(std::size_t to, const std::vector<Candidate>& candidates,
                              const std::vector<std::optional<Matrix6>>& known,
                              std::vector<Loop>& looked_at);
  bool bears_out(const Loop& a, const Loop& b) const;
  bool confirm(Loop loop, std::vector<Loop>& decided);
  Loop of_submaps(Loop loop) const;
  bool contradicts_mapping() const;
  Loop* contradiction(const std::vector<Pose>& poses);
  bool optimise(std::vector<Loop>& decided);
  bool move_to(const std::vector<Pose>& poses);
  std::vector<Between> factors(bool with_drift) const;

  GraphConfig config;
  std::vector<Node> nodes;
  std::vector<Place> places;
  // chain[i]: from i to i + 1.
  std::vector<Between> chain;
  std::vector<Loop> loops;
  std::uint32_t revision = 0;
  bool fitted = true;
  double chi2_before = 0.0, chi2_after = 0.0, last_move_m = 0.0;
};

void LoopGraph::State::add_node(const Submap& submap) {
  const std::vector<Eigen::Vector3f> points = points_near(submap, config.verify.reach_m);
  Place place{Surfaces(points), place_features(place_image(points, config.place), config.place)};
  place.T_place_submap.linear() = submap.T_map_submap.linear();
  place.T_map_place.translation() = submap.T_map_submap.translation();
  Node node{submap.sweep,        submap.instant_ns, submap.T_map_submap,
            submap.T_map_submap, submap.connected,  submap.step_m};
  place.T_world_place = place.T_map_place;
  if (!nodes.empty()) {
    const Place& before = places.back();
    Between step;
    step.from = nodes.size() - 1;
    step.to = nodes.size();
    step.T_from_to = before.T_map_place.inverse() * place.T_map_place;
    // Of what was missed between the two nothing is known but where both are.
    const bool missed = submap.before_sweep != nodes.back().sweep;
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
    node.way_m += nodes.back().way_m;
  }
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
    if (nodes[to].way_m - nodes[from].way_m < config.loop_way_m || !known[from]) continue;
    const Pose expected = places[from].T_world_place.inverse() * places[to].T_world_place;
    const double distance_m = expected.translation().head<2>().norm();
    const double sigma_m = std::sqrt(known[from]->topLeftCorner<2, 2>().trace());
    // Where it is known well enough, what is seen need not be asked for it.
    if (sigma_m < kSure_m) {
      if (distance_m < config.verify.radius_m / 2.0) near.push_back({from, expected, 0});
      continue;
    }
    if (distance_m > kReach_m + config.verify.radius_m + std::sqrt(kPlaneChi2) * sigma_m) continue;
    const PlaceMatch match = match_places(places[from].features, places[to].features, config.place);
    if (match.agreeing == 0) continue;
    Pose guess = turned_by(match.yaw_rad);
    guess.translation() << match.shift_m, 0.0;
    seen.push_back({from, guess, match.agreeing});
  }
  std::stable_sort(near.begin(), near.end(), [](const Candidate& a, const Candidate& b) {
    return a.guess.translation().squaredNorm() < b.guess.translation().squaredNorm();
  });
  std::stable_sort(seen.begin(), seen.end(),
                   [](const Candidate& a, const Candidate& b) { return a.agreeing > b.agreeing; });
  near.insert(near.end(), seen.begin(), seen.end());
  return distinct(near);
}

// Of those that say the same of where the newest submap is the first one.
std::vector<LoopGraph::State::Candidate> LoopGraph::State::distinct(
    const std::vector<Candidate>& all) const {
  std::vector<Candidate> out;
  for (const Candidate& candidate : all) {
    const Pose here = places[candidate.from].T_world_place * candidate.guess;
    const bool known = std::any_of(out.begin(), out.end(), [&](const Candidate& other) {
      const Pose there = places[other.from].T_world_place * other.guess;
      return (here.translation() - there.translation()).head<2>().norm() < kSameGuess_m;
    });
    if (!known) out.push_back(candidate);
    if (out.size() == config.candidates) break;
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
    const Pose expected = places[loop.from].T_world_place.inverse() * places[to].T_world_place;
    loop.chi2 = squared_distance(expected, loop.T_from_to, *known[loop.from] + loop.covariance);
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

// Around the ring of both loops and the ways between their ends.
bool LoopGraph::State::bears_out(const Loop& a, const Loop& b) const {
  if (a.to == b.to) return false;
  const auto way_m = [&](std::size_t i, std::size_t j) {
    return std::abs(nodes[i].way_m - nodes[j].way_m);
  };
  if (way_m(a.to, b.to) > config.confirm_way_m || way_m(a.from, b.from) > config.confirm_way_m) {
    return false;
  }
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

bool LoopGraph::State::confirm(Loop loop, std::vector<Loop>& decided) {
  bool accepted = false;
  for (Loop& other : loops) {
    if (other.verdict != Verdict::kAccepted && other.verdict != Verdict::kAlone) continue;
    if (!bears_out(loop, other)) continue;
    accepted = true;
    if (other.verdict == Verdict::kAccepted) continue;
    other.verdict = Verdict::kAccepted;
    decided.push_back(other);
  }
  if (accepted) loop.verdict = Verdict::kAccepted;
  loops.push_back(loop);
  decided.push_back(loop);
  return accepted;
}

// Mapping may have closed the loops by itself, by matching to what it saw the first time. Then they
// would only add their own errors to its poses.
bool LoopGraph::State::contradicts_mapping() const {
  double sum = 0.0;
  std::size_t count = 0;
  for (const Loop& loop : loops) {
    if (loop.verdict != Verdict::kAccepted) continue;
    const double off =
        chi2(factor_of(loop), places[loop.from].T_map_place, places[loop.to].T_map_place);
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
  std::vector<Pose> mapped;
  for (const Place& place : places) mapped.push_back(place.T_map_place);
  std::vector<Pose> poses = mapped;
  fitted = true;
  while (contradicts_mapping()) {
    const Optimised result = optimised(mapped, factors(false));
    fitted = result.converged;
    if (!fitted) return false;
    chi2_before = result.chi2_before;
    chi2_after = result.chi2_after;
    poses = result.poses;
    Loop* worst = contradiction(poses);
    if (!worst) break;
    worst->verdict = Verdict::kTakenBack;
    decided.push_back(*worst);
    poses = mapped;
  }
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

Update LoopGraph::add(const Submap& submap) {
  State& s = *state_;
  s.add_node(submap);
  const std::size_t to = s.nodes.size() - 1;
  std::vector<Pose> world;
  for (const State::Place& place : s.places) world.push_back(place.T_world_place);
  const auto known = uncertainties(to, world, s.factors(true));
  Update update;
  const auto best = s.best_of(to, s.candidates(to, known), known, update.loops);
  if (best && best->verdict != Verdict::kAlone) {
    update.loops.push_back(*best);
  } else if (best && s.confirm(*best, update.loops)) {
    update.revised = s.optimise(update.loops);
  }
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

Pose LoopGraph::corrected(std::int64_t instant_ns, const Pose& T_map_base) const {
  const std::vector<Node>& nodes = state_->nodes;
  if (nodes.empty()) return T_map_base;
  const auto correction = [&](const Node& n) {
    return n.T_world_submap * n.T_map_submap.inverse();
  };
  const auto after =
      std::upper_bound(nodes.begin(), nodes.end(), instant_ns,
                       [](std::int64_t instant, const Node& n) { return instant < n.instant_ns; });
  if (after == nodes.begin()) return correction(nodes.front()) * T_map_base;
  if (after == nodes.end()) return correction(nodes.back()) * T_map_base;
  const Node& before = *(after - 1);
  const double share = static_cast<double>(instant_ns - before.instant_ns) /
                       static_cast<double>(after->instant_ns - before.instant_ns);
  // Both ends of the stretch say where the pose is; what they differ by is spread over it.
  const Pose by_first = correction(before) * T_map_base;
  const Pose by_second = correction(*after) * T_map_base;
  return by_first * exp_se3(share * log_se3(by_first.inverse() * by_second));
}

}  // namespace zloam::graph
