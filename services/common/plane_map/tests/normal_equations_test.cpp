#include "common/plane_map/normal_equations.hpp"

#include <gtest/gtest.h>

#include "common/plane_map/sweep_matcher.hpp"
#include "common/plane_map/tests/room.hpp"

namespace zloam::plane_map {
namespace {

// A room's map and a sweep with a small pose error. Points near a voxel's border are left out,
// because the cost jumps there.
struct Problem {
  VoxelPlaneMap map{PlaneMapConfig{}};
  PointVector cloud;
  SweepMotion motion;

  Problem() {
    std::mt19937 random(3);
    testing::Scanner scanner;
    scanner.noise_m = 0.0;
    for (int k = 0; k < 5; ++k) {
      const PointVector points =
          testing::scan(testing::Room{}, scanner, Pose::Identity(), Vector6::Zero(), random);
      std::vector<Eigen::Vector3d> positions;
      for (const Point& p : points) {
        positions.push_back(p.position().cast<double>());
      }
      map.insert_points(positions);
    }
    cloud = testing::scan(testing::Room{}, scanner, Pose::Identity(), Vector6::Zero(), random);
    motion.T_mid = map.T_grid_map() * pose_from_xyz_rpy_deg({0.02, -0.03, 0.01}, {0.2, 0.3, -0.4});
    motion.twist << 0.01, 0.02, -0.01, 0.004, -0.003, 0.005;
    std::erase_if(cloud, [&](const Point& p) { return !lies_inside(p); });
    map.set_anchor(motion.T_mid.translation());
  }

  bool lies_inside(const Point& point) {
    const double s = point.time_ns * 1e-8 - 0.5;
    const Eigen::Vector3d at =
        map.T_grid_map().inverse() * motion.at(s) * point.position().cast<double>();
    const auto plane = map.plane_at(at);
    bool same = plane.has_value();
    for (int i = 0; same && i < 6; ++i) {
      const Eigen::Vector3d step = (i < 3 ? 0.01 : -0.01) * Eigen::Vector3d::Unit(i % 3);
      const auto other = map.plane_at(at + step);
      same = other && (other->normal - plane->normal).norm() < 1e-6;
    }
    return same;
  }

  SweepSums sums(const SweepMotion& at, const WeakAxis& weak = {}) {
    SweepInput sweep;
    sweep.points = cloud;
    const SweepPoints points(sweep, 0.5);
    matched.begin(points.points());
    return accumulate(map, points, matched, at, gate(), weak);
  }

  // Sum of the Geman-McClure costs k^2 r^2 / (k^2 + r^2) / 2, divided by the crowd's factor: the
  // weight is the square of k^2 / (k^2 + r^2), divided by the same factor.
  double cost(const SweepMotion& at) {
    sums(at);
    const double kernel2 = gate().kernel_m * gate().kernel_m;
    double sum = 0.0;
    for (const PlaneResidual& r : matched.residuals) {
      sum += 0.5 * r.weight * r.squared_m2 * (1.0 + r.squared_m2 / kernel2);
    }
    return sum;
  }

  Gate gate() const { return {0.3, 0.1, crowd_points}; }

  MatchedPoints matched;

  double crowd_points = 0.0;
};

class GradientOf : public ::testing::TestWithParam<double> {};
INSTANTIATE_TEST_SUITE_P(Crowds, GradientOf, ::testing::Values(0.0, 20.0));

TEST_P(GradientOf, MatchesNumericDifferences) {
  Problem problem;
  problem.crowd_points = GetParam();
  const Vector18 gradient = problem.sums(problem.motion).planes.gradient();
  ASSERT_GT(problem.cloud.size(), 4000u);
  constexpr double kStep = 2e-4;
  for (int i = 0; i < 18; ++i) {
    // A bend moves the points by an eighth of itself at most.
    const double scale = i < 12 ? 1.0 : 8.0;
    const auto cost = [&](double step) {
      SweepMotion moved = problem.motion;
      if (i < 6) {
        moved.T_mid = moved.T_mid * exp_se3(step * Vector6::Unit(i));
      } else {
        (i < 12 ? moved.twist : moved.bend)[i % 6] += scale * step;
      }
      return problem.cost(moved);
    };
    const double numeric = (cost(kStep) - cost(-kStep)) / (2.0 * scale * kStep);
    EXPECT_NEAR(gradient[i], numeric, 0.03 * gradient.segment<6>(i / 6 * 6).norm()) << i;
  }
}

TEST(NormalEquations, HessianIsSymmetricAndPositive) {
  Problem problem;
  const Matrix18 h = problem.sums(problem.motion).planes.hessian();
  EXPECT_LT((h - h.transpose()).norm(), 1e-3 * h.norm());
  for (int i = 0; i < 18; ++i) {
    EXPECT_GT(h(i, i), 0.0);
  }
}

TEST(NormalEquations, PriorGradientMatchesNumericDifferences) {
  MotionPrior prior;
  prior.predicted.T_mid = pose_from_xyz_rpy_deg({1, 2, 3}, {10, 20, 30});
  prior.predicted.twist << 0.1, 0.0, 0.0, 0.0, 0.0, 0.02;
  Matrix12 root = Matrix12::Identity();
  root.topRightCorner<6, 6>() = 0.5 * Matrix6::Identity();
  prior.information = 40.0 * root * root.transpose();
  prior.advised = prior.predicted;
  prior.advised.twist[1] = 0.03;
  prior.advice_information = 9.0 * Matrix12::Identity();
  const SweepMotion motion{
      prior.predicted.T_mid * pose_from_xyz_rpy_deg({0.01, 0.02, -0.01}, {0.1, -0.2, 0.3}),
      Vector6(1.05 * prior.predicted.twist)};
  const auto cost = [&](const SweepMotion& m) {
    Vector12 a;
    a << log_se3(prior.predicted.T_mid.inverse() * m.T_mid), m.twist - prior.predicted.twist;
    Vector12 b;
    b << log_se3(prior.advised.T_mid.inverse() * m.T_mid), m.twist - prior.advised.twist;
    return 0.5 * (a.dot(prior.information * a) + b.dot(prior.advice_information * b));
  };
  Matrix12 h = Matrix12::Zero();
  Vector12 g = Vector12::Zero();
  add_priors(prior, motion, h, g);
  for (int i = 0; i < 12; ++i) {
    SweepMotion plus = motion;
    SweepMotion minus = motion;
    if (i < 6) {
      plus.T_mid = plus.T_mid * exp_se3(1e-5 * Vector6::Unit(i));
      minus.T_mid = minus.T_mid * exp_se3(-1e-5 * Vector6::Unit(i));
    } else {
      plus.twist[i - 6] += 1e-5;
      minus.twist[i - 6] -= 1e-5;
    }
    // To first order in the error.
    EXPECT_NEAR(g[i], (cost(plus) - cost(minus)) / 2e-5, 0.02 * g.norm()) << i;
  }
}

TEST(NormalEquations, AlongAWeakAxisOnlyPlanesThatFaceItCount) {
  Problem problem;
  const Eigen::Vector3d axis_grid = problem.map.T_grid_map().linear() * Eigen::Vector3d::UnitX();
  const Eigen::Vector3d axis = problem.motion.T_mid.linear().transpose() * axis_grid;
  const Eigen::Vector3d across = axis.cross(Eigen::Vector3d::UnitZ()).normalized();
  const auto along = [&](const Eigen::Vector3d& direction, float least_cosine) {
    const WeakAxis weak{axis_grid.cast<float>(), least_cosine};
    const Matrix6 h = problem.sums(problem.motion, weak).planes.a0;
    return direction.dot(h.topLeftCorner<3, 3>() * direction);
  };
  const double all = along(axis, 0.0F);
  ASSERT_GT(all, 100.0);
  EXPECT_GT(along(axis, 0.1F), 0.95 * all);
  // No cosine exceeds 1.1: no information remains along the axis, and all of it across.
  EXPECT_LT(along(axis, 1.1F), 1e-3 * all);
  EXPECT_NEAR(along(across, 1.1F), along(across, 0.0F), 0.01 * along(across, 0.0F));
}

TEST(NormalEquations, NoPointsGiveNoInformation) {
  Problem problem;
  problem.cloud.clear();
  const NormalSums sums = problem.sums(problem.motion).planes;
  EXPECT_EQ(sums.matches, 0u);
  EXPECT_EQ(sums.hessian().norm(), 0.0);
}

}  // namespace
}  // namespace zloam::plane_map
