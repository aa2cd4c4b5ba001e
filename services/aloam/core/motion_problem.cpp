#include "aloam/core/motion_problem.hpp"

#include <ceres/ceres.h>

#include <cmath>

namespace zloam::aloam {
namespace {

constexpr double kHuber_m = 0.1;
constexpr int kIterations = 4;

}  // namespace

Pose Motion::pose() const {
  Pose pose = Pose::Identity();
  pose.linear() = q.normalized().toRotationMatrix();
  pose.translation() = t;
  return pose;
}

struct MotionProblem::State {
  // The problem owns the loss function once it is used. Motion::q is stored as x y z w, the order
  // that the manifold expects.
  ceres::LossFunction* loss = new ceres::HuberLoss(kHuber_m);
  ceres::Problem problem;
};

MotionProblem::MotionProblem(Motion& motion) : motion_(motion), state_(new State) {
  state_->problem.AddParameterBlock(motion.q.coeffs().data(), 4,
                                    new ceres::EigenQuaternionManifold);
  state_->problem.AddParameterBlock(motion.t.data(), 3);
}

MotionProblem::~MotionProblem() {
  // The problem deletes the loss function only if a residual block uses it.
  if (correspondences_ == 0) delete state_->loss;
}

void MotionProblem::add(ceres::CostFunction* cost) {
  state_->problem.AddResidualBlock(cost, state_->loss, motion_.q.coeffs().data(), motion_.t.data());
  ++correspondences_;
}

Solved MotionProblem::solve() {
  if (correspondences_ == 0) return {};
  const Motion before = motion_;
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_QR;
  options.max_num_iterations = kIterations;
  options.num_threads = 1;
  options.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &state_->problem, &summary);
  // One residual that is not finite makes Ceres give up; its cost is then -1.
  const bool finite = motion_.q.coeffs().allFinite() && motion_.t.allFinite();
  if (!summary.IsSolutionUsable() || !finite) {
    motion_ = before;
    return {};
  }
  return {static_cast<std::uint32_t>(summary.iterations.size()),
          std::sqrt(2.0 * summary.final_cost / correspondences_), true};
}

}  // namespace zloam::aloam
