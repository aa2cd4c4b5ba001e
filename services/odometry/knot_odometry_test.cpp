// A rotated 2-D scanner in a furnished room: its pose while it moves, with and without an IMU, and
// the reported health where the pose cannot be known.

#include "odometry/knot_odometry.hpp"

#include <gtest/gtest.h>

#include <bit>
#include <cmath>
#include <functional>
#include <numbers>
#include <random>

namespace zloam::odometry {
namespace {

constexpr double kPi = std::numbers::pi;
constexpr std::int64_t kSliceNs = 100'000'000;
constexpr int kLines = 4;
constexpr int kSteps = 181;  // per half circle

/// A room of 10 x 8 x 3 m with three boxes in it.
double range_to_room(const Eigen::Vector3d& from, const Eigen::Vector3d& along, bool tunnel) {
  double nearest = 1e9;
  const auto look = [&](const Eigen::Vector3d& low, const Eigen::Vector3d& high, bool inside) {
    double enter = 0.0, leave = 1e9;
    for (int i = 0; i < 3; ++i) {
      if (std::abs(along[i]) < 1e-12) continue;
      double a = (low[i] - from[i]) / along[i];
      double b = (high[i] - from[i]) / along[i];
      if (a > b) std::swap(a, b);
      enter = std::max(enter, a);
      leave = std::min(leave, b);
    }
    if (inside) nearest = std::min(nearest, leave);
    if (!inside && enter < leave && enter > 0.0) nearest = std::min(nearest, enter);
  };
  if (tunnel) {
    look({-500.0, -2.0, -1.0}, {500.0, 2.0, 2.0}, true);
    return nearest;
  }
  look({-5.0, -4.0, -1.0}, {5.0, 4.0, 2.0}, true);
  look({2.0, 1.0, -1.0}, {3.0, 2.5, 1.0}, false);
  look({-3.5, -2.5, -1.0}, {-2.0, -1.5, 0.3}, false);
  look({-1.0, 2.5, -1.0}, {0.5, 3.5, 1.2}, false);
  return nearest;
}

/// At rest for two seconds, then swinging at speeds of 0.4 m/s.
Pose T_room_base(double t_s) {
  const double moving_s = std::max(0.0, t_s - 2.0);
  const double eased_s = moving_s * moving_s / (moving_s + 1.0);
  Pose pose = Pose::Identity();
  pose.translation() =
      Eigen::Vector3d(1.2 * std::sin(0.3 * eased_s), 0.5 * (1.0 - std::cos(0.35 * eased_s)),
                      0.03 * std::sin(0.9 * eased_s));
  pose.linear() = exp_so3({0.02 * std::sin(0.8 * eased_s), 0.03 * std::sin(0.6 * eased_s),
                           0.5 * std::sin(0.4 * eased_s)});
  return pose;
}

struct Drive {
  std::mt19937 random{7};
  double noise_m = 0.01;
  bool tunnel = false;
  /// fault of the IMU, and the first slice with readings
  std::function<void(ImuReading&)> otherwise = [](ImuReading&) {};
  std::function<Pose(double)> motion = T_room_base;
  int imu_from = 0;
  PointVector points;
  std::vector<ImuReading> imu;

  FeatureSweep slice(int number, bool with_imu) {
    std::normal_distribution<double> noise(0.0, noise_m);
    const std::int64_t begin_ns = number * kSliceNs;
    points.clear();
    for (int line = 0; line < kLines; ++line) {
      for (int step = 0; step < kSteps; ++step) {
        const std::int64_t at_ns = (line * kSliceNs + step * kSliceNs / kSteps) / kLines;
        const double t_s = 1e-9 * static_cast<double>(begin_ns + at_ns);
        const double roll = kPi * t_s;  // half a revolution per second
        const double theta = -kPi / 2.0 + kPi * step / (kSteps - 1);
        const Eigen::Vector3d along_base(std::cos(theta), std::sin(theta) * std::cos(roll),
                                         std::sin(theta) * std::sin(roll));
        const Pose T = motion(t_s);
        const double range_m =
            range_to_room(T.translation(), T.linear() * along_base, tunnel) + noise(random);
        if (range_m > 30.0) continue;
        const Eigen::Vector3f p = (range_m * along_base).cast<float>();
        points.push_back({p.x(), p.y(), p.z(), 0.0F, static_cast<std::uint32_t>(at_ns),
                          static_cast<std::uint16_t>((number * kLines + line) % 64),
                          ReturnType::kStrongest, 0});
      }
    }
    FeatureSweep sweep;
    sweep.sweep = static_cast<std::uint64_t>(number);
    sweep.stamp_ns = 1'700'000'000'000'000'000 + begin_ns;
    sweep.period_ns = kSliceNs;
    sweep.slices = 10;
    sweep.range_noise_m = noise_m;
    sweep.less_flat = points;
    if (with_imu && number >= imu_from) {
      sweep.imu = readings(begin_ns, sweep.stamp_ns - begin_ns);
    }
    return sweep;
  }

  /// Readings of an IMU with constant biases and no noise, from differences of the motion.
  ImuSpan readings(std::int64_t begin_ns, std::int64_t zero_ns) {
    imu.clear();
    constexpr std::int64_t kStepNs = 5'000'000;
    for (std::int64_t at = begin_ns - 30'000'000; at <= begin_ns + kSliceNs + 30'000'000;
         at += kStepNs) {
      const double t = 1e-9 * static_cast<double>(at);
      constexpr double h = 1e-3;
      const Pose a = motion(t - h), b = motion(t), c = motion(t + h);
      const Eigen::Vector3d acceleration =
          (c.translation() - 2.0 * b.translation() + a.translation()) / (h * h);
      ImuReading reading;
      reading.stamp_ns = zero_ns + at;
      reading.force_mps2 = b.linear().transpose() * (acceleration + Eigen::Vector3d(0, 0, 9.81)) +
                           Eigen::Vector3d(0.02, -0.01, 0.01);
      reading.rate_radps = log_so3(a.linear().transpose() * c.linear()) / (2.0 * h) +
                           Eigen::Vector3d(2e-3, -1e-3, 1e-3);
      otherwise(reading);
      imu.push_back(reading);
    }
    return imu;
  }
};

struct Outcome {
  double worst_m = 0.0;
  double rms_m = 0.0;
  int not_ok = 0;
  OdometryDiagnostics last;
};

Outcome drive(KnotOdometry& odometry, int slices, bool with_imu, Drive scans = {}) {
  Outcome out;
  int counted = 0;
  for (int i = 0; i < slices; ++i) {
    const OdometryResult result = odometry.process(scans.slice(i, with_imu));
    if (i < 20) continue;
    const Pose truth = T_room_base(1e-9 * static_cast<double>((i + 1) * kSliceNs));
    const double off_m = (result.T_odom_base.translation() - truth.translation()).norm();
    out.worst_m = std::max(out.worst_m, off_m);
    out.rms_m += off_m * off_m;
    out.not_ok += result.health == Health::kOk ? 0 : 1;
    out.last = result.diagnostics;
    ++counted;
  }
  out.rms_m = std::sqrt(out.rms_m / counted);
  return out;
}

TEST(KnotOdometryTest, FollowsWithAnInertialSensor) {
  KnotOdometry odometry({}, Pose::Identity(), Pose::Identity());
  const Outcome out = drive(odometry, 250, true);
  EXPECT_EQ(out.not_ok, 0);
  EXPECT_LT(out.rms_m, 0.02);
  EXPECT_LT(out.worst_m, 0.05);
}

TEST(KnotOdometryTest, FollowsWithoutOne) {
  KnotOdometry odometry({}, Pose::Identity(), Pose::Identity());
  const Outcome out = drive(odometry, 250, false);
  EXPECT_EQ(out.not_ok, 0);
  EXPECT_LT(out.rms_m, 0.04);
  EXPECT_LT(out.worst_m, 0.12);
}

void in_degrees(ImuReading& r) { r.rate_radps *= 180.0 / kPi; }
void yaw_reversed(ImuReading& r) { r.rate_radps.z() *= -1.0; }

// As accurate as without an IMU. One that reads degrees has rotated the first revolution, and with
// it the frame, by its bias before it is detected.
TEST(KnotOdometryTest, ASensorThatThePointsContradictIsLeftOut) {
  for (const auto& [otherwise, rms_m] : {std::pair{&yaw_reversed, 0.06}, {&in_degrees, 0.25}}) {
    KnotOdometry odometry({}, Pose::Identity(), Pose::Identity());
    Drive scans;
    scans.otherwise = otherwise;
    const Outcome out = drive(odometry, 250, true, scans);
    EXPECT_GE(out.last.imu_contradictions, 2U);
    EXPECT_FALSE(out.last.imu_used);
    EXPECT_EQ(out.not_ok, 0);
    EXPECT_LT(out.rms_m, rms_m);
  }
}

TEST(KnotOdometryTest, AForceThatIsNotGravitysIsLeftOut) {
  KnotOdometry odometry({}, Pose::Identity(), Pose::Identity());
  Drive scans;
  scans.otherwise = [](ImuReading& r) { r.force_mps2 *= 0.5; };
  const Outcome out = drive(odometry, 250, true, scans);
  EXPECT_FALSE(out.last.imu_used);
  EXPECT_EQ(out.not_ok, 0);
  EXPECT_LT(out.rms_m, 0.04);
}

TEST(KnotOdometryTest, ReadingsMayBeginLaterAlsoWhileItMoves) {
  for (const int from : {1, 7, 45}) {
    KnotOdometry odometry({}, Pose::Identity(), Pose::Identity());
    Drive scans;
    scans.imu_from = from;
    const Outcome out = drive(odometry, 250, true, scans);
    EXPECT_EQ(out.last.imu_contradictions, 0U) << from;
    EXPECT_TRUE(out.last.imu_used) << from;
    EXPECT_EQ(out.not_ok, 0) << from;
    EXPECT_LT(out.rms_m, 0.03) << from;
  }
}

TEST(KnotOdometryTest, TheSameSlicesGiveTheSameBytes) {
  std::vector<Eigen::Matrix4d> poses[2];
  for (auto& all : poses) {
    KnotOdometry odometry({}, Pose::Identity(), Pose::Identity());
    Drive scans;
    for (int i = 0; i < 40; ++i) {
      all.push_back(odometry.process(scans.slice(i, true)).T_odom_base.matrix());
    }
  }
  EXPECT_EQ(poses[0], poses[1]);
}

/// The slices so far as registration keeps them.
struct Kept {
  std::vector<FeatureSweep> sweeps;
  std::deque<PointVector> points;
  std::deque<std::vector<ImuReading>> imu;

  const FeatureSweep& add(Drive& scans, int number, bool with_imu) {
    FeatureSweep sweep = scans.slice(number, with_imu);
    sweep.less_flat = points.emplace_back(scans.points);
    if (with_imu) sweep.imu = imu.emplace_back(scans.imu);
    return sweeps.emplace_back(sweep);
  }
  SliceAt since(std::uint64_t first) const {
    return [this, first](std::uint64_t sweep) -> std::optional<FeatureSweep> {
      if (sweep < first || sweep >= sweeps.size()) return std::nullopt;
      return sweeps[sweep];
    };
  }
};

/// The second of two instances continues from the first one's state after slice 59, with the slices
/// from first_kept on. Returns the largest difference of their poses, m.
double taken_over_apart_m(
    bool with_imu, std::uint64_t first_kept,
    const std::function<void(ImuReading&)>& otherwise = [](ImuReading&) {}) {
  OdometryConfig config;
  config.window_sweeps = 3;
  KnotOdometry first(config, Pose::Identity(), Pose::Identity());
  KnotOdometry second(config, Pose::Identity(), Pose::Identity());
  Drive scans;
  scans.otherwise = otherwise;
  Kept kept;
  double apart_m = 0.0;
  for (int i = 0; i < 90; ++i) {
    const FeatureSweep& sweep = kept.add(scans, i, with_imu);
    const OdometryResult result = first.process(sweep);
    EXPECT_EQ(first.state().empty(), i < 29 || i % 10 != 9) << i;
    if (i == 59) {
      EXPECT_TRUE(second.restore(first.state(), kept.since(first_kept)));
    }
    if (i < 60) continue;
    const OdometryResult other = second.process(sweep);
    EXPECT_EQ(other.health, Health::kOk);
    EXPECT_EQ(other.planes.size(), result.planes.size());
    const Pose off = result.T_odom_base.inverse() * other.T_odom_base;
    apart_m = std::max(apart_m, off.translation().norm());
    if (first_kept <= 10) {
      EXPECT_EQ(first.state(), second.state());
    }
  }
  return apart_m;
}

TEST(KnotOdometryTest, AnotherInstanceGoesOnWithTheSameBytes) {
  EXPECT_EQ(taken_over_apart_m(true, 0), 0.0);
  EXPECT_EQ(taken_over_apart_m(false, 10), 0.0);
  EXPECT_EQ(taken_over_apart_m(true, 0, in_degrees), 0.0);
}

TEST(KnotOdometryTest, AnotherInstanceGoesOnNearlySoWithFewerSlices) {
  const double apart_m = taken_over_apart_m(true, 25);
  EXPECT_GT(apart_m, 0.0);
  EXPECT_LT(apart_m, 0.01);
}

TEST(KnotOdometryTest, AStateThatDoesNotSufficeIsRefused) {
  KnotOdometry odometry({}, Pose::Identity(), Pose::Identity());
  Drive scans;
  Kept kept;
  for (int i = 0; i < 60; ++i) odometry.process(kept.add(scans, i, false));
  const std::vector<std::uint64_t> state = odometry.state();
  const auto refused = [&](std::span<const std::uint64_t> words, std::uint64_t first_kept) {
    KnotOdometry second({}, Pose::Identity(), Pose::Identity());
    const bool restored = second.restore(words, kept.since(first_kept));
    EXPECT_EQ(second.process(kept.sweeps[0]).prev_sweep, 0U) << "not as new";
    return !restored;
  };
  EXPECT_TRUE(refused(state, 45)) << "the window's slices are gone";
  EXPECT_TRUE(refused(state, 36)) << "the target's slices are gone";
  EXPECT_TRUE(refused({}, 0));
  EXPECT_TRUE(refused(std::span(state).first(state.size() - 1), 0));
  std::vector<std::uint64_t> other = state;
  ++other.front();
  EXPECT_TRUE(refused(other, 0)) << "another layout";
  for (const std::uint64_t wild : {~std::uint64_t{0}, std::bit_cast<std::uint64_t>(1e300)}) {
    for (std::size_t k = 1; k < state.size(); k += 3) {
      other = state;
      other[k] = wild;
      KnotOdometry second({}, Pose::Identity(), Pose::Identity());
      if (second.restore(other, kept.since(0))) second.process(kept.sweeps.back());
    }
  }
}

TEST(KnotOdometryTest, EachSliceIsHandedOnOnceItHasSettled) {
  KnotOdometry odometry({}, Pose::Identity(), Pose::Identity());
  Drive scans;
  std::size_t points = 0;
  for (int i = 0; i < 60; ++i) {
    const OdometryResult result = odometry.process(scans.slice(i, false));
    const bool turn_ends = i >= 19 && i % 10 == 9;
    EXPECT_EQ(!result.planes.empty(), turn_ends) << i;
    points += result.planes.size();
    // The points are given in base_link at the result's instant, so they lie within the walls.
    for (std::size_t k = 0; k < result.planes.size(); k += 97) {
      const Eigen::Vector3d p =
          T_room_base(0.1 * (i + 1)) * result.planes[k].position().cast<double>();
      EXPECT_LT(p.cwiseAbs().x(), 5.15);
      EXPECT_LT(p.cwiseAbs().y(), 4.15);
    }
  }
  EXPECT_EQ(points, std::size_t{50 * kLines * kSteps});
}

TEST(KnotOdometryTest, SlicesOfAnotherPlaceAreNotCalledWell) {
  KnotOdometry odometry({}, Pose::Identity(), Pose::Identity());
  Drive scans;
  for (int i = 0; i < 40; ++i) odometry.process(scans.slice(i, false));
  int well = 0;
  for (int i = 40; i < 60; ++i) {
    FeatureSweep sweep = scans.slice(i, false);
    // Carried away in an instant: the room is rotated and of another size.
    for (Point& p : scans.points) {
      const float x = p.x;
      p.x = 0.5F * p.y;
      p.y = -1.7F * x;
    }
    sweep.less_flat = scans.points;
    const Health health = odometry.process(sweep).health;
    if (i >= 50) well += health == Health::kOk ? 1 : 0;
  }
  EXPECT_EQ(well, 0);
}

/// Additionally rolls to and fro by this angle at 4 Hz, from the fifth second on.
Drive shaken(double roll_rad) {
  Drive scans;
  scans.motion = [roll_rad](double t_s) -> Pose {
    Pose pose = T_room_base(t_s);
    const double since_s = std::max(0.0, t_s - 5.0);
    const double angle_rad = roll_rad * std::sin(8.0 * kPi * since_s);
    pose.linear() = pose.linear() * exp_so3({angle_rad, 0.0, 0.0});
    return pose;
  };
  return scans;
}

// A few wrong poses may be Ok: the share of unconverged solutions takes part of a revolution to
// grow.
TEST(KnotOdometryTest, AMotionThatSlicesCannotFollowIsNotCalledWell) {
  constexpr double kOff_m = 0.3;
  int wrong = 0, silent = 0;
  for (const double roll_rad : {0.3, 0.6, 0.9}) {
    KnotOdometry odometry({}, Pose::Identity(), Pose::Identity());
    Drive scans = shaken(roll_rad);
    std::vector<Pose> off;
    for (int i = 0; i < 200; ++i) {
      const OdometryResult result = odometry.process(scans.slice(i, false));
      const Pose truth = scans.motion(1e-9 * static_cast<double>((i + 1) * kSliceNs));
      off.push_back(result.T_odom_base * truth.inverse());
      if (i < 20) continue;
      // motion during the last second
      if ((off[i - 10].inverse() * off[i]).translation().norm() < kOff_m) continue;
      ++wrong;
      silent += result.health == Health::kOk ? 1 : 0;
    }
  }
  EXPECT_GT(wrong, 50);
  EXPECT_LE(10 * silent, wrong);
}

TEST(KnotOdometryTest, ASilenceBeginsATargetAnew) {
  KnotOdometry odometry({}, Pose::Identity(), Pose::Identity());
  Drive scans;
  for (int i = 0; i < 40; ++i) {
    EXPECT_FALSE(odometry.process(scans.slice(i, false)).new_frame) << i;
  }
  // After a silence of half a second, and after a clock that was set back.
  for (const int begin : {46, 20}) {
    const OdometryResult result = odometry.process(scans.slice(begin, false));
    EXPECT_EQ(result.prev_sweep, std::uint64_t(begin));
    EXPECT_TRUE(result.planes.empty());
    EXPECT_TRUE(result.new_frame) << begin;
    for (int i = begin + 1; i < begin + 5; ++i) {
      EXPECT_FALSE(odometry.process(scans.slice(i, false)).new_frame) << i;
    }
  }
}

TEST(KnotOdometryTest, AShortSilenceIsBridged) {
  KnotOdometry odometry({}, Pose::Identity(), Pose::Identity());
  Drive scans;
  for (int i = 0; i < 40; ++i) odometry.process(scans.slice(i, false));
  const OdometryResult result = odometry.process(scans.slice(44, false));
  EXPECT_EQ(result.prev_sweep, 39U);
  EXPECT_FALSE(result.new_frame);
}

TEST(KnotOdometryTest, TheAxisOfATunnelIsSaidToBeOpen) {
  KnotOdometry odometry({}, Pose::Identity(), Pose::Identity());
  Drive scans;
  scans.tunnel = true;
  for (int i = 0; i < 50; ++i) {
    const OdometryResult result = odometry.process(scans.slice(i, false));
    if (i < 20) continue;
    ASSERT_EQ(result.health, Health::kDegenerate) << i;
    EXPECT_GT(std::abs(result.degeneracy.weak_translation.x()), 0.9);
  }
}

TEST(KnotOdometryTest, EmptySlicesAreSaid) {
  KnotOdometry odometry({}, Pose::Identity(), Pose::Identity());
  Drive scans;
  for (int i = 0; i < 30; ++i) odometry.process(scans.slice(i, false));
  FeatureSweep empty = scans.slice(30, false);
  empty.less_flat = {};
  EXPECT_EQ(odometry.process(empty).health, Health::kEmpty);
}

/// A wall across the x axis, with a point every 25 mm.
PointVector wall_at(float x_m) {
  PointVector points;
  for (int y = -80; y <= 80; ++y) {
    for (int z = -40; z <= 40; ++z) {
      points.push_back({x_m, 0.025F * static_cast<float>(y), 0.025F * static_cast<float>(z), 0.0F,
                        0, 0, ReturnType::kStrongest, 0});
    }
  }
  return points;
}

// Points on both sides of a wall match it while the kernel is wide, and not at the end.
TEST(KnotWindowTest, TooFewMatchesAtTheEndAreNoSolution) {
  const OdometryConfig config;
  WindowMap target(config, 0.01);
  target.add(wall_at(5.0F), Pose::Identity());
  Slice slice;
  for (const float off_m : {-0.45F, 0.45F}) {
    const PointVector points = wall_at(5.0F + off_m);
    // Few, so that the motion before holds them there.
    for (std::size_t i = 0; i < points.size(); i += 40) {
      slice.points.push_back({points[i].position().cast<double>(), 0.5});
    }
  }
  KnotWindow window(config);
  window.begin(Pose::Identity());
  window.push(slice);
  const KnotSolution solution = window.solve(target, 0.01);
  EXPECT_EQ(solution.iterations, 1U);
  EXPECT_FALSE(solution.solved);
  EXPECT_EQ(solution.explained, 0.0);
  EXPECT_EQ(window.knots().back().matrix(), Pose::Identity().matrix());
}

}  // namespace
}  // namespace zloam::odometry
