#include "graph/pose_graph.hpp"

#include <ceres/ceres.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <array>
#include <limits>
#include <numeric>

namespace zloam::graph {
namespace {

// Scale of the robust loss: beyond what is likely with six degrees of freedom a loop has less and
// less weight.
constexpr double kRobustSigmas = 3.5;
constexpr int kMostIterations = 100;

/// Not a number for a matrix that is no covariance, so that no fit with it converges.
Matrix6 square_root_information(const Matrix6& covariance) {
  const Matrix6 symmetric = 0.5 * (covariance + covariance.transpose());
  const Matrix6 information = symmetric.ldlt().solve(Matrix6::Identity());
  const Eigen::LLT<Matrix6> root(0.5 * (information + information.transpose()));
  if (root.info() != Eigen::Success) {
    return Matrix6::Constant(std::numeric_limits<double>::quiet_NaN());
  }
  return root.matrixL().transpose();
}

struct State {
  std::array<double, 3> translation;
  std::array<double, 4> rotation;  // x y z w
};

class BetweenCost {
 public:
  explicit BetweenCost(const Between& factor)
      : translation_(factor.T_from_to.translation()),
        rotation_(factor.T_from_to.linear()),
        root_(square_root_information(factor.covariance)) {}

  template <typename T>
  bool operator()(const T* from_t, const T* from_q, const T* to_t, const T* to_q,
                  T* residuals) const {
    using Vector3 = Eigen::Matrix<T, 3, 1>;
    using Quaternion = Eigen::Quaternion<T>;
    const Eigen::Map<const Vector3> a(from_t), b(to_t);
    const Eigen::Map<const Quaternion> p(from_q), q(to_q);
    const Quaternion measured_inverse = rotation_.conjugate().template cast<T>();
    Quaternion off = measured_inverse * (p.conjugate() * q);
    if (off.w() < T(0.0)) off.coeffs() = -off.coeffs();
    Eigen::Matrix<T, 6, 1> error;
    error.template head<3>() =
        measured_inverse * (p.conjugate() * (b - a) - translation_.template cast<T>());
    error.template tail<3>() = T(2.0) * off.vec();
    Eigen::Map<Eigen::Matrix<T, 6, 1>> out(residuals);
    out = root_.template cast<T>() * error;
    return true;
  }

 private:
  Eigen::Vector3d translation_;
  Eigen::Quaterniond rotation_;
  Matrix6 root_;
};

State state_of(const Pose& pose) {
  const Eigen::Quaterniond q(pose.linear());
  const Eigen::Vector3d& t = pose.translation();
  return {{t.x(), t.y(), t.z()}, {q.x(), q.y(), q.z(), q.w()}};
}

Pose pose_of(const State& state) {
  Pose pose = Pose::Identity();
  pose.translation() = Eigen::Map<const Eigen::Vector3d>(state.translation.data());
  pose.linear() =
      Eigen::Map<const Eigen::Quaterniond>(state.rotation.data()).normalized().toRotationMatrix();
  return pose;
}

/// The first pose of each connected component of the factors.
std::vector<std::size_t> firsts_of_parts(std::size_t count, std::span<const Between> factors) {
  std::vector<std::size_t> before(count);
  std::iota(before.begin(), before.end(), std::size_t{0});
  const auto first_of = [&](std::size_t i) {
    while (before[i] != i) i = before[i] = before[before[i]];
    return i;
  };
  for (const Between& factor : factors) {
    const std::size_t a = first_of(factor.from), b = first_of(factor.to);
    before[std::max(a, b)] = std::min(a, b);
  }
  std::vector<std::size_t> firsts;
  for (std::size_t i = 0; i < count; ++i) {
    if (first_of(i) == i) firsts.push_back(i);
  }
  return firsts;
}

ceres::Solver::Options solver_options() {
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::SPARSE_NORMAL_CHOLESKY;
  options.sparse_linear_algebra_library_type = ceres::EIGEN_SPARSE;
  options.num_threads = 1;
  options.max_num_iterations = kMostIterations;
  options.function_tolerance = 1e-10;
  options.parameter_tolerance = 1e-12;
  options.logging_type = ceres::SILENT;
  return options;
}

}  // namespace

double squared_distance(const Pose& expected, const Pose& found, const Matrix6& covariance) {
  const Vector6 error = log_se3(expected.inverse() * found);
  return error.dot(covariance.ldlt().solve(error));
}

double chi2(const Between& factor, const Pose& T_world_from, const Pose& T_world_to) {
  return squared_distance(factor.T_from_to, T_world_from.inverse() * T_world_to, factor.covariance);
}

Optimised optimised(std::vector<Pose> poses, std::span<const Between> factors) {
  Optimised out;
  if (poses.empty()) return out;
  std::vector<State> states;
  for (const Pose& pose : poses) states.push_back(state_of(pose));
  ceres::Problem problem;
  for (State& state : states) {
    problem.AddParameterBlock(state.translation.data(), 3);
    problem.AddParameterBlock(state.rotation.data(), 4, new ceres::EigenQuaternionManifold);
  }
  for (const std::size_t first : firsts_of_parts(states.size(), factors)) {
    problem.SetParameterBlockConstant(states[first].translation.data());
    problem.SetParameterBlockConstant(states[first].rotation.data());
  }
  for (const Between& factor : factors) {
    auto* cost =
        new ceres::AutoDiffCostFunction<BetweenCost, 6, 3, 4, 3, 4>(new BetweenCost(factor));
    State& from = states[factor.from];
    State& to = states[factor.to];
    problem.AddResidualBlock(cost, factor.robust ? new ceres::CauchyLoss(kRobustSigmas) : nullptr,
                             from.translation.data(), from.rotation.data(), to.translation.data(),
                             to.rotation.data());
  }
  ceres::Solver::Summary summary;
  ceres::Solve(solver_options(), &problem, &summary);
  out.converged = summary.termination_type == ceres::CONVERGENCE;
  out.chi2_before = 2.0 * summary.initial_cost;
  out.chi2_after = 2.0 * summary.final_cost;
  out.poses.reserve(states.size());
  for (const State& state : states) out.poses.push_back(pose_of(state));
  return out;
}

}  // namespace zloam::graph
