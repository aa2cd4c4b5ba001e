#include "common/plane_map/moments.hpp"

#include <Eigen/Eigenvalues>
#include <algorithm>

namespace zloam::plane_map {
namespace {

// A plane is never known to better than a millimetre.
constexpr double kMinVariance = 1e-6;

double squared(double x) { return x * x; }

PlaneGates gates(const PlaneMapConfig& c, double thickness_sigmas, double width_sigmas) {
  return {static_cast<double>(c.min_points), squared(thickness_sigmas * c.range_noise_m),
          squared(width_sigmas * c.range_noise_m), c.aspect, squared(c.normal_error_rad)};
}

}  // namespace

void Moments::add(const Moments& other, const Eigen::Vector3d& offset) {
  const Eigen::Matrix3d cross = other.sum * offset.transpose();
  count += other.count;
  sum += other.sum + other.count * offset;
  squares += other.squares + cross + cross.transpose() + other.count * offset * offset.transpose();
}

Eigen::Matrix3d Moments::covariance() const {
  const Eigen::Vector3d m = mean();
  return squares / count - m * m.transpose();
}

PlaneGates own_gates(const PlaneMapConfig& config) {
  return gates(config, config.thickness_sigmas, config.width_sigmas);
}

PlaneGates merged_gates(const PlaneMapConfig& config) {
  return gates(config, config.merged_thickness_sigmas, config.merged_width_sigmas);
}

PrincipalAxes principal_axes(const Moments& moments) {
  Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver;
  solver.computeDirect(moments.covariance());
  PrincipalAxes out;
  out.centre = moments.mean();
  out.variances = solver.eigenvalues().cwiseMax(kMinVariance);
  out.axes = solver.eigenvectors();
  return out;
}

bool is_plane(const PrincipalAxes& axes, double count, const PlaneGates& gates) {
  const double l0 = axes.variances[0];
  const double l1 = axes.variances[1];
  return count >= gates.min_points && l0 < gates.max_thickness2 && l1 > gates.min_width2 &&
         l1 > gates.aspect * l0 && axes.normal_variance(count) < gates.normal_error2;
}

}  // namespace zloam::plane_map
