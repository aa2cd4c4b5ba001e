#include "common/plane_map/sweep_matcher.hpp"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>

#include "common/containers/thinning.hpp"
#include "common/geometry/motion_covariance.hpp"

namespace zloam::plane_map {
namespace {

// The first step, from the prediction's error of centimetres to millimetres, needs only every 8th
// point; the other points are then looked up once, at the better pose. So few points hardly reduce
// each other's weight (Gate::crowd_points), which is intended: near surfaces, hit by many points,
// reveal an unexpected rotation.
constexpr std::size_t kCoarseStride = 8;
constexpr std::size_t kLeastCoarsePoints = 200;
constexpr int kLeastIterations = 2;

// Least sigma of the bend, for a platform that was never seen to accelerate: m, rad over a sweep.
constexpr double kLeastBend = 1e-6;

constexpr double kLeastWeight = 1e-12;

bool is_small(const Vector12& step, const MatcherConfig& c) {
  const double translation = step.segment<3>(0).norm() + step.segment<3>(6).norm();
  const double rotation = step.segment<3>(3).norm() + step.segment<3>(9).norm();
  return rotation < c.stop_rotation_rad && translation < c.stop_translation_m;
}

bool is_sound(const Vector12& step) { return step.allFinite() && step.norm() <= 1e3; }

SweepMotion moved(const SweepMotion& motion, const Vector12& step, const Vector6& bend_step) {
  SweepMotion out = motion;
  out.T_mid = normalised(motion.T_mid * exp_se3(step.head<6>()));
  out.twist += step.tail<6>();
  out.bend += bend_step;
  return out;
}

// Information about one 3-vector when the other one is estimated along with it (Schur complement).
Eigen::Matrix3d schur(const Matrix6& a, int keep, int drop) {
  const Eigen::Matrix3d other = a.block<3, 3>(drop, drop) + 1e-9 * Eigen::Matrix3d::Identity();
  return a.block<3, 3>(keep, keep) -
         a.block<3, 3>(keep, drop) * other.ldlt().solve(a.block<3, 3>(drop, keep));
}

// Information of the normals about translations, with the rotation estimated along with them;
// eigenvalues ascending.
Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> held(const NormalSums& sums) {
  return Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(schur(sums.a0, 0, 3));
}

double sigma_along(const Eigen::Matrix3d& covariance, const Eigen::Vector3d& axis) {
  return std::sqrt(std::max(0.0, axis.dot(covariance * axis)));
}

// Covariance of a motion near the priors' start by the priors alone, without the IMU.
Matrix12 predicted_covariance(MotionPrior prior) {
  if (prior.usual_information) prior.information = *prior.usual_information;
  Matrix12 h = 1e-9 * Matrix12::Identity();
  Vector12 g = Vector12::Zero();
  add_priors(prior, prior.start, h, g);
  return h.ldlt().solve(Matrix12::Identity());
}

}  // namespace

void add_priors(const MotionPrior& prior, const SweepMotion& motion, Matrix12& h, Vector12& g) {
  const auto add = [&](const SweepMotion& expected, const Matrix12& information) {
    Vector12 error;
    error << log_se3(expected.T_mid.inverse() * motion.T_mid), motion.twist - expected.twist;
    h += information;
    g += information * error;
  };
  add(prior.predicted, prior.information);
  if (!prior.advice_information.isZero(0.0)) {
    add(prior.advised, prior.advice_information);
  }
}

SweepMatcher::Step SweepMatcher::step_from(const SweepMotion& motion, VoxelPlaneMap& map,
                                           const SweepPoints& sweep, MatchedPoints& matched,
                                           const MotionPrior& prior, const Gate& gate) const {
  const WeakAxis weak{prior.weak_axis_grid.cast<float>(),
                      static_cast<float>(config_.weak_least_cosine)};
  Step out;
  out.sums = accumulate(map, sweep, matched, motion, gate, weak);
  const double scale = information_scale(map);
  Matrix18 h = out.sums.planes.hessian();
  Vector18 g = out.sums.planes.gradient();
  // With an IMU, its prior constrains such directions better than spurious information would.
  if (prior.usual_information) discount_spurious(out.sums.planes, h, g);
  h = (scale * (h + out.sums.blobs.hessian())).eval();
  g = (scale * (g + out.sums.blobs.gradient())).eval();
  out.h = h.topLeftCorner<12, 12>();
  Vector12 g12 = g.head<12>();
  add_priors(prior, motion, out.h, g12);
  Vector6 bend_information = prior.bend_sigma.array().max(kLeastBend).square().inverse();
  Matrix6 h_bend = h.bottomRightCorner<6, 6>();
  h_bend.diagonal() += bend_information;
  const Vector6 g_bend = g.tail<6>() + bend_information.cwiseProduct(motion.bend);
  out.bend.own_covariance = h_bend.ldlt().solve(Matrix6::Identity());
  out.bend.by_motion = out.bend.own_covariance * h.bottomLeftCorner<6, 12>();
  out.h -= h.topRightCorner<12, 6>() * out.bend.by_motion;
  g12 -= out.bend.by_motion.transpose() * g_bend;
  out.step = -out.h.ldlt().solve(g12);
  out.bend_step = -out.bend.own_covariance * g_bend - out.bend.by_motion * out.step;
  return out;
}

double SweepMatcher::information_scale(const VoxelPlaneMap& map) const {
  const double noise = map.config().range_noise_m;
  return 1.0 / (noise * noise * config_.correlation);
}

SweepMotion SweepMatcher::come_near(VoxelPlaneMap& map, const SweepPoints& sweep,
                                    const MotionPrior& prior, const Gate& gate) const {
  std::vector<SlotPoint> few;
  few.reserve(sweep.points().size() / kCoarseStride + 1);
  Thinning{kCoarseStride}.each(sweep.points(), [&](const SlotPoint& p) { few.push_back(p); });
  if (few.size() < kLeastCoarsePoints) return prior.start;
  MatchedPoints matched;
  matched.begin(few);
  const Step first = step_from(prior.start, map, sweep, matched, prior, gate);
  return is_sound(first.step) ? moved(prior.start, first.step, first.bend_step) : prior.start;
}

Gate SweepMatcher::fine_gate(const MatchGates& gates, const NormalSums& first) const {
  const double share = gates.share
                           ? *gates.share
                           : held(first).eigenvalues()[0] / std::max(first.weight, kLeastWeight);
  const double wider = std::max(1.0, config_.fine_least_share / std::max(share, 1e-9));
  return {std::min(gates.first.limit_m, wider * config_.fine_gate_m),
          std::min(gates.first.kernel_m, wider * config_.fine_kernel_m), config_.crowd_points};
}

MatchResult SweepMatcher::match(VoxelPlaneMap& map, const SweepPoints& sweep,
                                const MotionPrior& prior, const MatchGates& gates) {
  MatchResult result;
  result.motion = prior.start;
  SweepMotion motion = come_near(map, sweep, prior, gates.first);
  matched_.begin(sweep.points());
  Step last;
  Gate gate = gates.first;
  for (int i = 0; i < config_.max_iterations && !result.converged; ++i) {
    if (i == 1) gate = fine_gate(gates, last.sums.planes);
    last = step_from(motion, map, sweep, matched_, prior, gate);
    result.iterations = i + 1;
    if (!is_sound(last.step)) {
      return result;
    }
    motion = moved(motion, last.step, last.bend_step);
    result.converged = i + 1 >= kLeastIterations && is_small(last.step, config_);
  }
  const SweepSums& sums = last.sums;
  const std::size_t matches = sums.planes.matches + sums.blobs.matches;
  result.tried = sweep.points().size();
  result.matches = matches;
  if (matches < config_.min_matches) {
    return result;
  }
  result.valid = true;
  result.motion = motion;
  result.covariance = last.h.ldlt().solve(Matrix12::Identity());
  if (sees_a_part(slot_fraction(sweep.points().front().slot),
                  slot_fraction(sweep.points().back().slot))) {
    result.seen_at = seen_at(sums.planes.hessian());
  }
  result.bend = last.bend;
  const ResidualAccount account =
      account_of(matched_.residuals, gates.first.kernel_m, config_.fine_kernel_m);
  result.degeneracy =
      judge(sums.planes, account.lever2, predicted_covariance(prior), information_scale(map));
  result.residual_rms_m = std::sqrt(account.told_root_squared / std::max(account.told_root, 1e-12));
  result.inlier_rms_m = std::sqrt(account.told_squared / std::max(account.told_weight, 1e-12));
  result.matched_weight = sums.planes.weight + sums.blobs.weight;
  result.explained_weight = account.fine_weight;
  result.matched_fraction = static_cast<double>(matches) / static_cast<double>(result.tried);
  return result;
}

double SweepMatcher::spurious(const NormalSums& sums) const {
  return std::max(sums.normal_variance,
                  sums.weight * config_.normal_error_rad * config_.normal_error_rad);
}

void SweepMatcher::discount_spurious(const NormalSums& sums, Matrix18& h, Vector18& g) const {
  const auto translation = held(sums);
  if (translation.eigenvalues()[1] < config_.walls_least_share * sums.weight) return;
  const double least = std::max(translation.eigenvalues()[0], 1e-12);
  const double real = std::max(0.0, 1.0 - spurious(sums) / least);
  keep_along(translation.eigenvectors().col(0), real, h, g);
}

Degeneracy SweepMatcher::judge(const NormalSums& sums, double lever2, const Matrix12& predicted,
                               double scale) const {
  Degeneracy out;
  const double weight = std::max(sums.weight, kLeastWeight);

  const double errors = spurious(sums);
  const auto sigma = [&](double eigenvalue) {
    constexpr double kLeast = 1.0 / (kNothingKnown_m * kNothingKnown_m);
    return 1.0 / std::sqrt(std::max(scale * (eigenvalue - errors), kLeast));
  };
  const auto translation = held(sums);
  out.axis = translation.eigenvectors().col(0);
  out.share = translation.eigenvalues()[0] / weight;
  out.second_share = translation.eigenvalues()[1] / weight;
  out.measured_sigma_m = sigma(translation.eigenvalues()[0]);
  out.predicted_sigma_m = sigma_along(predicted.block<3, 3>(0, 0), out.axis);

  // Rotations in units of the lever arm, so that eigenvalues mean the same as above.
  const double lever = std::sqrt(std::max(lever2 / weight, 1e-12));
  Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> rotation(schur(sums.a0, 3, 0) / (lever * lever));
  out.rotation_axis = rotation.eigenvectors().col(0);
  out.measured_sigma_rad = sigma(rotation.eigenvalues()[0]) / lever;
  out.predicted_sigma_rad = sigma_along(predicted.block<3, 3>(3, 3), out.rotation_axis);
  out.weak = out.measured_sigma_m > kWeakRatio * out.predicted_sigma_m;
  return out;
}

}  // namespace zloam::plane_map
