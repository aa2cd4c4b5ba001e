#include "graph/verification.hpp"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>

namespace zloam::graph {
namespace {

// Normals of floors and flat ground have a larger vertical component than this.
constexpr float kLevel = 0.8F;
// A surface this near to a plane lies on it.
constexpr float kOn_m = 0.15F;
// Added to the number of surfaces compared, as if they had no counterpart: a handful proves
// nothing.
constexpr double kDoubt = 10.0;
// Minimum cosine between two normals of the same surface.
constexpr float kAlike = 0.95F;
constexpr double kLeastNoise_m = 0.03;
constexpr double kStop_m = 1e-4, kStop_rad = 1e-5;
// The errors of a submap's surfaces are correlated: information is divided by this.
constexpr double kCorrelation = 20.0;

struct Sums {
  Matrix6 hessian = Matrix6::Zero();
  Vector6 gradient = Vector6::Zero();
  Eigen::Matrix2d horizontal = Eigen::Matrix2d::Zero();
  double weight = 0.0, squared = 0.0;
  std::size_t matches = 0;
};

/// Every stride-th surface of b against those of a.
Sums sums_at(const Surfaces& a, const Surfaces& b, std::size_t stride, const Pose& T_a_b,
             double gate_m) {
  Sums sums;
  const double kernel2 = gate_m * gate_m / 9.0;
  const Eigen::Isometry3f T = T_a_b.cast<float>();
  const std::vector<Surfel>& surfels = b.fine.surfels();
  for (std::size_t i = 0; i < surfels.size(); i += stride) {
    const Eigen::Vector3f at = T * surfels[i].centre;
    const Surfel* surface = a.at(at);
    if (!surface || !surface->is_plane()) continue;
    const auto residual = static_cast<double>(surface->normal.dot(at - surface->centre));
    if (std::abs(residual) > gate_m) continue;
    // Geman and McClure.
    const double scale = kernel2 / (kernel2 + residual * residual);
    const double weight = scale * scale;
    // Right perturbation: T exp(x) p moves by R (rho + theta x p).
    const Eigen::Vector3d normal_a = surface->normal.cast<double>();
    const Eigen::Vector3d normal_b = T_a_b.linear().transpose() * normal_a;
    Vector6 row;
    row << normal_b, surfels[i].centre.cast<double>().cross(normal_b);
    sums.hessian += weight * row * row.transpose();
    sums.gradient += weight * residual * row;
    const Eigen::Vector2d level = normal_a.head<2>();
    sums.horizontal += weight * level * level.transpose();
    sums.weight += weight;
    sums.squared += weight * residual * residual;
    ++sums.matches;
  }
  return sums;
}

/// Whether a surface element coincides with a plane of the other submap.
bool is_on(const Surfel& surface, const Eigen::Vector3f& at, const Eigen::Vector3f& normal) {
  return surface.is_plane() && std::abs(surface.normal.dot(normal)) > kAlike &&
         std::abs(surface.normal.dot(at - surface.centre)) < kOn_m;
}

/// Share of b's planes off the ground and near a's sensor that coincide with a plane of a.
double share_on(const Surfaces& a, const Surfaces& b, const Pose& T_a_b, double radius_m) {
  std::size_t asked = 0, on = 0;
  const Eigen::Isometry3f T = T_a_b.cast<float>();
  const Eigen::Matrix3f R = T.linear();
  const auto radius = static_cast<float>(radius_m);
  for (const Surfel& surfel : b.fine.surfels()) {
    const Eigen::Vector3f at = T * surfel.centre;
    if (!surfel.is_plane() || std::abs(surfel.normal.z()) > kLevel) continue;
    if (at.squaredNorm() > radius * radius) continue;
    ++asked;
    if (const Surfel* surface = a.fine.at(at); surface && is_on(*surface, at, R * surfel.normal)) {
      ++on;
    }
  }
  return static_cast<double>(on) / (static_cast<double>(asked) + kDoubt);
}

double weakest(const Eigen::Matrix2d& horizontal) {
  const double all = horizontal.trace();
  if (!(all > 0.0)) return 0.0;
  return Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d>(horizontal).eigenvalues().x() / all;
}

Matrix6 covariance_of_match(const Sums& sums, double noise_m, const VerifyConfig& config) {
  Matrix6 floor = Matrix6::Zero();
  floor.diagonal().head<3>().setConstant(config.sigma_m * config.sigma_m);
  floor.diagonal().tail<3>().setConstant(config.sigma_rad * config.sigma_rad);
  Matrix6 information = sums.hessian / (noise_m * noise_m * kCorrelation);
  information.diagonal().array() += 1e-6;
  return floor + information.inverse();
}

}  // namespace

Overlap matched(const Surfaces& a, const Surfaces& b, const Pose& guess,
                const VerifyConfig& config) {
  const std::size_t stride = std::max<std::size_t>(1, b.fine.surfels().size() / config.surfaces);
  Overlap out;
  out.T_a_b = guess;
  Sums sums;
  for (int i = 0; i < config.iterations; ++i) {
    const double along = static_cast<double>(i) / (config.iterations - 1);
    const double gate_m =
        config.gate_start_m * std::pow(config.gate_end_m / config.gate_start_m, along);
    sums = sums_at(a, b, stride, out.T_a_b, gate_m);
    if (sums.matches < 50) return out;
    Matrix6 damped = sums.hessian;
    damped.diagonal().array() += 1e-6 * sums.weight;
    const Vector6 step = -damped.ldlt().solve(sums.gradient);
    if (!step.allFinite() || step.head<3>().norm() > config.gate_start_m * 4.0) return out;
    out.T_a_b = normalised(out.T_a_b * exp_se3(step));
    const bool still = step.head<3>().norm() < kStop_m && step.tail<3>().norm() < kStop_rad;
    if (still && gate_m <= config.gate_end_m * 1.01) break;
  }
  sums = sums_at(a, b, stride, out.T_a_b, config.gate_end_m);
  out.residual_m = std::sqrt(sums.squared / std::max(sums.weight, 1e-9));
  out.weakest_share = weakest(sums.horizontal);
  out.share = std::min(share_on(a, b, out.T_a_b, config.radius_m),
                       share_on(b, a, out.T_a_b.inverse(), config.radius_m));
  out.covariance = covariance_of_match(sums, std::max(out.residual_m, kLeastNoise_m), config);
  return out;
}

}  // namespace zloam::graph
