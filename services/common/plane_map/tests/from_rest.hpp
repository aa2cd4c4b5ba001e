#pragma once
// A sensor that stands, then drives off along x: planes seen at rest must not hold it back.

#include <algorithm>
#include <random>

#include "common/plane_map/scan_to_map.hpp"
#include "common/plane_map/tests/room.hpp"

namespace zloam::plane_map::testing {

/// Worst error of the pose at mid-sweep over twenty sweeps at rest and forty more, in which the
/// speed grows by step_mps per sweep up to top_mps.
template <typename Scene>
double worst_from_rest_m(const Scene& scene, double step_mps, double top_mps, unsigned seed,
                         const PlaneMapConfig& map, const MatcherConfig& matcher) {
  ScanToMap tracker{map, matcher};
  std::mt19937 random(seed);
  Scanner scanner;
  scanner.columns = 1800;
  scanner.noise_m = 0.02;
  scanner.lowest_deg = -15.0;
  scanner.highest_deg = 15.0;
  Pose T_start = Pose::Identity();
  double worst_m = 0.0;
  for (int k = 0; k < 60; ++k) {
    Vector6 v = Vector6::Zero();
    v[0] = std::clamp(step_mps * (k - 20), 0.0, top_mps);
    const PointVector points = scan(scene, scanner, T_start, v, random);
    SweepInput sweep;
    sweep.points = points;
    sweep.stamp_ns = k * 100'000'000LL;
    const Pose T = tracker.process(sweep).T_map_base_mid;
    const Pose truth = T_start * exp_se3(0.05 * v);
    worst_m = std::max(worst_m, (T.translation() - truth.translation()).norm());
    T_start = T_start * exp_se3(0.1 * v);
  }
  return worst_m;
}

}  // namespace zloam::plane_map::testing
