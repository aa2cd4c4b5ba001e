#include <gtest/gtest.h>

#include <random>

#include "common/geometry/deskew.hpp"
#include "common/geometry/se3.hpp"

namespace zloam {
namespace {

Vector6 random_twist(std::mt19937& rng, double scale) {
  std::uniform_real_distribution<double> u(-scale, scale);
  return Vector6::NullaryExpr([&](auto) { return u(rng); });
}

TEST(Se3, LogInvertsExpFromTinyToLargeMotions) {
  std::mt19937 rng(1);
  for (double scale : {1e-9, 1e-6, 1e-4, 1e-2, 0.5, 1.7}) {
    for (int i = 0; i < 50; ++i) {
      const Vector6 x = random_twist(rng, scale);
      EXPECT_LT((log_se3(exp_se3(x)) - x).norm(), 1e-9 * (1.0 + scale));
    }
  }
}

TEST(Se3, ExpMatchesManySmallSteps) {
  Vector6 twist;
  twist << 1.0, -0.5, 0.2, 0.3, 0.8, -1.1;
  Pose sum = Pose::Identity();
  const int steps = 200000;
  for (int i = 0; i < steps; ++i) {
    Pose step = Pose::Identity();
    const Eigen::Vector3d w = twist.tail<3>() / steps;
    step.linear() = Eigen::AngleAxisd(w.norm(), w.normalized()).toRotationMatrix();
    step.translation() = twist.head<3>() / steps;
    sum = sum * step;
  }
  EXPECT_LT((sum.matrix() - exp_se3(twist).matrix()).norm(), 1e-5);
}

TEST(Se3, ExpAlongAScrewIsExpOfEach) {
  std::mt19937 rng(3);
  for (const std::size_t count : {0U, 1U, 31U, 33U, 1025U}) {
    const Vector6 twist = random_twist(rng, 2.0);
    const std::vector<Pose> motions = exp_se3_along(twist, -0.7, 1e-3, count);
    ASSERT_EQ(motions.size(), count);
    for (std::size_t i = 0; i < count; ++i) {
      const Pose expected = exp_se3((-0.7 + 1e-3 * static_cast<double>(i)) * twist);
      EXPECT_LT((motions[i].matrix() - expected.matrix()).norm(), 1e-14) << i;
    }
  }
}

TEST(Se3, AdjointMovesATwistThroughAPose) {
  std::mt19937 rng(2);
  for (int i = 0; i < 20; ++i) {
    const Pose pose = exp_se3(random_twist(rng, 1.5));
    const Vector6 x = random_twist(rng, 0.3);
    const Pose left = exp_se3(adjoint(pose) * x);
    const Pose right = pose * exp_se3(x) * pose.inverse();
    EXPECT_LT((left.matrix() - right.matrix()).norm(), 1e-12);
  }
}

TEST(Se3, UpsideDownMountingTurnsUpIntoDown) {
  const Pose mount = pose_from_xyz_rpy_deg({0.1, 0.2, 0.3}, {180.0, 0.0, 0.0});
  const Eigen::Vector3d up = mount.linear() * Eigen::Vector3d::UnitZ();
  EXPECT_LT((up + Eigen::Vector3d::UnitZ()).norm(), 1e-12);
}

TEST(Se3, YawIsAppliedLast) {
  const Pose mount = pose_from_xyz_rpy_deg({0, 0, 0}, {0.0, 90.0, 90.0});
  // Pitch takes x to -z; yaw about z leaves it there.
  EXPECT_LT((mount.linear() * Eigen::Vector3d::UnitX() + Eigen::Vector3d::UnitZ()).norm(), 1e-12);
}

TEST(Deskew, ATableInPlaceOfAnotherTakesItsPointsToTheOwnPlaces) {
  std::mt19937 rng(4);
  const std::uint32_t period = 100'000'000;
  const DeskewTable believed(random_twist(rng, 2.0), period, period);
  const DeskewTable right(random_twist(rng, 2.0), period, period);
  const DeskewTable again = right.in_place_of(believed);
  const Eigen::Vector3d point(5.0, -3.0, 1.0);
  for (std::uint32_t time = 0; time <= period; time += 9'999'999) {
    const Eigen::Vector3d moved = again.motion_at(time) * (believed.motion_at(time) * point);
    EXPECT_LT((moved - right.motion_at(time) * point).norm(), 1e-12);
  }
}

// The angular rate grows evenly from 0.5 to 1.1 rad per sweep, without the table's formula.
TEST(Deskew, ATurnOfChangingRateBecomesOnePoint) {
  const std::uint32_t period = 100'000'000;
  const auto turned = [](double part) {
    return exp_so3({0.0, 0.0, 0.5 * part + 0.5 * 0.6 * part * part});
  };
  Vector6 twist = Vector6::Zero();
  twist[5] = 10.0 * (0.5 + 0.5 * 0.6);
  Vector6 bend = Vector6::Zero();
  bend[5] = 0.6;
  const DeskewTable table = DeskewTable(twist, period, period).bent(bend);
  const Eigen::Vector3d world(12.0, -4.0, 1.5);
  const Eigen::Vector3d expected = turned(1.0).transpose() * world;
  for (int i = 0; i <= 16; ++i) {
    const auto time = static_cast<std::uint32_t>(i * (period / 16));
    const Eigen::Vector3d seen = turned(i / 16.0).transpose() * world;
    EXPECT_LT((table.motion_at(time) * seen - expected).norm(), 1e-9) << i;
  }
}

TEST(Deskew, StaticPointSeenFromAMovingSensorBecomesOnePoint) {
  Vector6 twist;
  twist << 3.0, 0.5, -0.1, 0.05, -0.1, 1.5;
  const std::uint32_t period = 100000000;
  const Pose base_at_start = Pose::Identity();
  const Eigen::Vector3d world(12.0, -4.0, 1.5);
  PointVector sweep;
  for (std::uint32_t t = 0; t <= period; t += 1000003) {
    const Pose at_t = base_at_start * exp_se3(twist * (t * 1e-9));
    const Eigen::Vector3f seen = (at_t.inverse() * world).cast<float>();
    sweep.push_back({seen.x(), seen.y(), seen.z(), 1.0F, t, 0, ReturnType::kStrongest, 0});
  }
  const PointVector moved = deskewed(sweep, DeskewTable(twist, period, period));
  const Eigen::Vector3d expected = exp_se3(twist * (period * 1e-9)).inverse() * world;
  ASSERT_EQ(moved.size(), sweep.size());
  for (const Point& p : moved) {
    EXPECT_LT((p.position().cast<double>() - expected).norm(), 2e-3);
  }
}

}  // namespace
}  // namespace zloam
