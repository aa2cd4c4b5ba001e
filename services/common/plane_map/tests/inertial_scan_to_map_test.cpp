// What the IMU's preintegrated motion adds to the matching, in an endless corridor and in a room.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <optional>

#include "common/plane_map/scan_to_map.hpp"
#include "common/plane_map/tests/room.hpp"

namespace zloam::plane_map {
namespace {

using testing::Room;
using testing::scan;
using testing::Scanner;

constexpr double kPeriod_s = 0.1;
constexpr std::int64_t kPeriod_ns = 100'000'000;

Scanner noisy() {
  Scanner scanner;
  scanner.columns = 1200;
  scanner.noise_m = 0.02;
  return scanner;
}

// Twelve sweeps at rest, then up to 3 m/s along x within fifteen.
Vector6 twist_of(int k) {
  Vector6 v = Vector6::Zero();
  v[0] = std::clamp(0.2 * (k - 11), 0.0, 3.0);
  return v;
}

// A true step, with the covariance of an IMU that errs by 2 mm/s and 0.2 mrad per sweep.
InertialStep step_to(int k) {
  InertialStep step;
  step.velocity_change_mps = (twist_of(k) - twist_of(k - 1)).head<3>();
  Vector6 sigma;
  sigma << 0.002, 0.002, 0.002, 2e-4, 2e-4, 2e-4;
  step.covariance = sigma.array().square().matrix().asDiagonal();
  step.at_rest = k < 12;
  return step;
}

struct Errors {
  double worst_step_m = 0.0;
  double end_m = 0.0;
  int weak = 0;
};

// told(k): the IMU's step to sweep k.
template <typename Told>
Errors ride(const Room& room, Told&& told) {
  ScanToMap tracker{PlaneMapConfig{}, MatcherConfig{}};
  std::mt19937 random(5);
  Pose T_start = Pose::Identity();
  Pose last_found = Pose::Identity(), last_truth = Pose::Identity();
  Errors errors;
  for (int k = 0; k < 40; ++k) {
    const Vector6 v = twist_of(k);
    const PointVector points = scan(room, noisy(), T_start, v, random);
    SweepInput sweep;
    sweep.points = points;
    sweep.stamp_ns = k * kPeriod_ns;
    sweep.inertial = told(k);
    const ScanToMapResult result = tracker.process(sweep);
    const Pose truth = T_start * exp_se3(0.5 * kPeriod_s * v);
    if (k > 1) {
      const Eigen::Vector3d ours = (last_found.inverse() * result.T_map_base_mid).translation();
      const Eigen::Vector3d true_step = (last_truth.inverse() * truth).translation();
      errors.worst_step_m = std::max(errors.worst_step_m, (ours - true_step).norm());
    }
    errors.weak += result.degeneracy.weak ? 1 : 0;
    errors.end_m = (result.T_map_base_mid.translation() - truth.translation()).norm();
    last_found = result.T_map_base_mid;
    last_truth = truth;
    T_start = T_start * exp_se3(kPeriod_s * v);
  }
  return errors;
}

std::optional<InertialStep> nothing(int /*k*/) { return std::nullopt; }
std::optional<InertialStep> all(int k) { return k == 0 ? std::nullopt : std::optional(step_to(k)); }

TEST(InertialRegistration, GoesThroughAnEndlessCorridorFromRest) {
  Room corridor;
  corridor.open_x = true;
  const Errors without = ride(corridor, nothing);
  EXPECT_GT(without.end_m, 2.0) << "something faces along the corridor";
  const Errors with = ride(corridor, all);
  EXPECT_LT(with.end_m, 0.1);
  EXPECT_LT(with.worst_step_m, 0.02);
  // The position is known, yet the points still leave the corridor's axis degenerate.
  EXPECT_GT(with.weak, 35);
}

TEST(InertialRegistration, WhereThePointsTellAllItTakesNothing) {
  Room hall;
  hall.low = {-9.0, -4.0, -1.5};
  hall.high = {11.0, 4.0, 2.0};
  const Errors with = ride(hall, all);
  EXPECT_LT(with.end_m, 0.01);
  EXPECT_EQ(with.weak, 0);
}

// The IMU's step is used only if it starts from the sweep directly before.
TEST(InertialRegistration, IsNotUsedAfterAGap) {
  const auto twist_found = [](int end, bool told) {
    ScanToMap tracker{PlaneMapConfig{}, MatcherConfig{}};
    std::mt19937 random(5);
    ScanToMapResult last;
    for (const int k : {0, 1, 2, 3, end}) {
      const PointVector points = scan(Room{}, noisy(), Pose::Identity(), Vector6::Zero(), random);
      SweepInput sweep;
      sweep.points = points;
      sweep.stamp_ns = k * kPeriod_ns;
      if (told && k == end) {
        sweep.inertial = step_to(1);
        sweep.inertial->velocity_change_mps << 5.0, 0.0, 0.0;
        sweep.inertial->at_rest = false;
      }
      last = tracker.process(sweep);
    }
    return last.twist_per_s;
  };
  EXPECT_EQ(twist_found(6, true), twist_found(6, false));
  EXPECT_NE(twist_found(4, true), twist_found(4, false)) << "nor is it used without a gap";
}

}  // namespace
}  // namespace zloam::plane_map
