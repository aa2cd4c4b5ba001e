// The one-pass normal equations against Ceres on the same problem.

#include "mapping/alignment.hpp"

#include <ceres/ceres.h>
#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <random>

namespace zloam::mapping {
namespace {

constexpr double kKernel_m = 0.1;

class GemanMcClure final : public ceres::LossFunction {
 public:
  explicit GemanMcClure(double information) : k2_(information * kKernel_m * kKernel_m) {}
  // s holds the information already.
  void Evaluate(double s, double out[3]) const override {
    const double d = k2_ + s;
    out[0] = k2_ * s / d;
    out[1] = k2_ * k2_ / (d * d);
    out[2] = -2.0 * k2_ * k2_ / (d * d * d);
  }

 private:
  double k2_;
};

struct DistanceCost {
  const Residual* r;
  template <typename T>
  bool operator()(const T* const q, const T* const t, T* out) const {
    const Eigen::Map<const Eigen::Quaternion<T>> rotation(q);
    const Eigen::Map<const Eigen::Matrix<T, 3, 1>> translation(t);
    const Eigen::Matrix<T, 3, 1> offset =
        rotation * r->point_base.cast<T>() + translation - r->surface.point.cast<T>();
    const Eigen::Matrix<T, 3, 1> axis = r->surface.axis.cast<T>();
    const T along = axis.dot(offset);
    const T scale = T(std::sqrt(r->information));
    Eigen::Map<Eigen::Matrix<T, 3, 1>> error(out);
    if (r->line) {
      error = scale * (offset - along * axis);
    } else {
      error = Eigen::Matrix<T, 3, 1>(scale * along, T(0), T(0));
    }
    return true;
  }
};

struct PriorCost {
  Pose T_p;
  Matrix6 root;
  template <typename T>
  bool operator()(const T* const q, const T* const t, T* out) const {
    const Eigen::Map<const Eigen::Quaternion<T>> rotation(q);
    const Eigen::Map<const Eigen::Matrix<T, 3, 1>> translation(t);
    const Eigen::Quaternion<T> predicted(Eigen::Quaterniond(T_p.linear()).cast<T>());
    const Eigen::Quaternion<T> difference = predicted.conjugate() * rotation;
    const T half = difference.vec().norm();
    const T angle = T(2.0) * atan2(half, difference.w());
    Eigen::Matrix<T, 6, 1> x;
    x.template head<3>() = predicted.conjugate() * (translation - T_p.translation().cast<T>());
    x.template tail<3>() = difference.vec() * (angle / half);
    Eigen::Map<Eigen::Matrix<T, 6, 1>> error(out);
    error = root.cast<T>() * x;
    return true;
  }
};

struct Problem {
  std::vector<Residual> residuals;
  Prediction prediction;
};

Problem random_problem(unsigned seed) {
  std::mt19937 generator(seed);
  std::normal_distribution<double> normal(0.0, 1.0);
  const auto vector = [&] {
    return Eigen::Vector3d(normal(generator), normal(generator), normal(generator));
  };
  Problem p;
  Vector6 truth, error;
  truth << 2.0 * vector(), 0.5 * vector();
  error << 0.05 * vector(), 0.02 * vector();
  const Pose T = exp_se3(truth);
  p.prediction.T_map_base = T * exp_se3(error);
  const Matrix6 A = Matrix6::Random();
  p.prediction.covariance = 1e-3 * (A * A.transpose() + Matrix6::Identity());
  for (int i = 0; i < 200; ++i) {
    Residual r;
    r.point_base = 8.0 * vector();
    r.surface.axis = vector().normalized();
    r.line = i % 3 == 0;
    r.information = i % 2 == 0 ? 250.0 : 100.0;
    // One in ten is an outlier.
    r.surface.point = T * r.point_base + (i % 10 == 0 ? 0.3 : 0.02) * vector();
    p.residuals.push_back(r);
  }
  return p;
}

Pose solve_with_ceres(const Problem& p) {
  Eigen::Quaterniond q(p.prediction.T_map_base.linear());
  // Ceres' own derivative of the prior has no value at exactly zero difference.
  q = q * Eigen::Quaterniond(exp_so3(Eigen::Vector3d(1e-5, 0, 0)));
  Eigen::Vector3d t = p.prediction.T_map_base.translation();
  ceres::Problem problem;
  problem.AddParameterBlock(q.coeffs().data(), 4, new ceres::EigenQuaternionManifold);
  problem.AddParameterBlock(t.data(), 3);
  for (const Residual& r : p.residuals) {
    problem.AddResidualBlock(
        new ceres::AutoDiffCostFunction<DistanceCost, 3, 4, 3>(new DistanceCost{&r}),
        new GemanMcClure(r.information), q.coeffs().data(), t.data());
  }
  const Matrix6 information = p.prediction.covariance.inverse();
  const Matrix6 root = information.llt().matrixU();
  problem.AddResidualBlock(new ceres::AutoDiffCostFunction<PriorCost, 6, 4, 3>(
                               new PriorCost{p.prediction.T_map_base, root}),
                           nullptr, q.coeffs().data(), t.data());
  ceres::Solver::Options options;
  options.max_num_iterations = 500;
  options.function_tolerance = 0.0;
  options.gradient_tolerance = 1e-13;
  options.parameter_tolerance = 1e-15;
  options.num_threads = 1;
  options.linear_solver_type = ceres::DENSE_QR;
  options.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  Pose pose = Pose::Identity();
  pose.linear() = q.normalized().toRotationMatrix();
  pose.translation() = t;
  return pose;
}

TEST(Alignment, AgreesWithCeres) {
  for (unsigned seed = 1; seed <= 10; ++seed) {
    const Problem p = random_problem(seed);
    const Pose own = align(p.residuals, p.prediction, kKernel_m, 500, 1e-13, 1e-13);
    const Pose reference = solve_with_ceres(p);
    const Vector6 difference = log_se3(reference.inverse() * own);
    EXPECT_LT(difference.norm(), 1e-9) << "seed " << seed;
    EXPECT_GT(log_se3(p.prediction.T_map_base.inverse() * own).norm(), 1e-3);
  }
}

TEST(Alignment, WithoutResidualsThePredictionStays) {
  Prediction prediction;
  prediction.T_map_base = pose_from_xyz_rpy_deg({1, 2, 3}, {4, 5, 6});
  const Pose pose = align({}, prediction, kKernel_m, 10, 1e-9, 1e-9);
  EXPECT_TRUE(pose.isApprox(prediction.T_map_base, 1e-12));
}

}  // namespace
}  // namespace zloam::mapping
