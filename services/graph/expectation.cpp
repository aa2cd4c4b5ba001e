#include "graph/expectation.hpp"

#include <queue>
#include <tuple>

namespace zloam::graph {
namespace {

struct Arc {
  std::size_t other;
  std::size_t factor;
};

}  // namespace

std::vector<std::optional<Matrix6>> uncertainties(std::size_t to, std::span<const Pose> poses,
                                                  std::span<const Between> factors) {
  std::vector<std::vector<Arc>> arcs(poses.size());
  for (std::size_t i = 0; i < factors.size(); ++i) {
    arcs[factors[i].from].push_back({factors[i].to, i});
    arcs[factors[i].to].push_back({factors[i].from, i});
  }
  std::vector<std::optional<Matrix6>> known(poses.size());
  using Open = std::tuple<double, std::size_t, Matrix6>;
  const auto later = [](const Open& a, const Open& b) {
    return std::tie(std::get<0>(a), std::get<1>(a)) > std::tie(std::get<0>(b), std::get<1>(b));
  };
  std::priority_queue<Open, std::vector<Open>, decltype(later)> open(later);
  open.emplace(0.0, to, Matrix6::Zero());
  const Pose T_to_world = poses[to].inverse();
  while (!open.empty()) {
    const auto [variance, at, covariance] = open.top();
    open.pop();
    if (known[at]) continue;
    known[at] = covariance;
    for (const Arc& arc : arcs[at]) {
      if (known[arc.other]) continue;
      // A factor's covariance is a tangent at its end, in whichever direction the path uses it.
      const Pose T_to_end = T_to_world * poses[factors[arc.factor].to];
      const Matrix6 sum = covariance + carried(factors[arc.factor].covariance, T_to_end);
      open.emplace(sum.topLeftCorner<3, 3>().trace(), arc.other, sum);
    }
  }
  return known;
}

}  // namespace zloam::graph
