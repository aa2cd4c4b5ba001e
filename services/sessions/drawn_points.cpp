#include "sessions/drawn_points.hpp"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <optional>

#include "common/plane_map/moments.hpp"

namespace zloam::sessions {
namespace {

using plane_map::Moments;
using plane_map::MomentSums;
using plane_map::SavedVoxel;

Moments moments_of(const SavedVoxel& voxel) {
  return {voxel.count, MomentSums<float>{voxel.sum, voxel.squares}};
}

Eigen::Vector3d centre_of(const SavedVoxel& voxel, double root_voxel_m) {
  const double edge_m = root_voxel_m / (1 << voxel.level);
  return (Eigen::Vector3d(voxel.x, voxel.y, voxel.z).array() + 0.5).matrix() * edge_m;
}

/// The voxel's sums without those of its children, which a plane drops when it is known well
/// enough; nothing: its children have counted all.
std::optional<Moments> own_moments(const SavedVoxel& voxel, const Moments& of_children) {
  Moments own = moments_of(voxel);
  if (own.count <= of_children.count) return std::nullopt;
  own.count -= of_children.count;
  own.sum -= of_children.sum;
  own.squares -= of_children.squares;
  return own;
}

/// For each voxel the sums of its children, relative to its centre.
std::vector<Moments> sums_of_children(std::span<const SavedVoxel> voxels, double root_voxel_m) {
  std::vector<Moments> sums(voxels.size());
  // Each voxel is followed by its children, and those by theirs.
  std::vector<std::size_t> open;
  for (std::size_t i = 0; i < voxels.size(); ++i) {
    while (!open.empty() && voxels[open.back()].level >= voxels[i].level) open.pop_back();
    if (!open.empty()) {
      const Eigen::Vector3d offset =
          centre_of(voxels[i], root_voxel_m) - centre_of(voxels[open.back()], root_voxel_m);
      sums[open.back()].add(moments_of(voxels[i]), offset);
    }
    open.push_back(i);
  }
  return sums;
}

/// Number from 0 to 1 with the digits of n in this base, in reverse (Halton).
double halton(std::uint32_t n, std::uint32_t base) {
  double value = 0.0, digit = 1.0;
  for (; n > 0; n /= base) {
    digit /= base;
    value += digit * (n % base);
  }
  return value;
}

/// Of so few points the covariance has a rank of one less.
std::vector<Eigen::Vector3d> unit_cloud(std::uint32_t count) {
  std::vector<Eigen::Vector3d> cloud;
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (std::uint32_t i = 1; i <= count; ++i) {
    cloud.emplace_back(halton(i, 5), halton(i, 3), halton(i, 2));
    mean += cloud.back() / count;
  }
  const int rank = static_cast<int>(std::min(3U, count - 1));
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
  for (Eigen::Vector3d& p : cloud) {
    p -= mean;
    p.head(3 - rank).setZero();
    covariance += p * p.transpose() / count;
  }
  if (rank == 0) return cloud;
  const Eigen::MatrixXd block = covariance.bottomRightCorner(rank, rank);
  const Eigen::MatrixXd whiten =
      Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd>(block).operatorInverseSqrt();
  for (Eigen::Vector3d& p : cloud) p.tail(rank) = (whiten * p.tail(rank)).eval();
  return cloud;
}

}  // namespace

std::vector<Patch> patches_of(std::span<const SavedVoxel> voxels, double root_voxel_m) {
  const std::vector<Moments> of_children = sums_of_children(voxels, root_voxel_m);
  std::vector<Patch> patches;
  for (std::size_t i = 0; i < voxels.size(); ++i) {
    const auto own = own_moments(voxels[i], of_children[i]);
    if (!own) continue;
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solved(own->covariance());
    Patch patch;
    patch.count = static_cast<std::uint32_t>(own->count);
    patch.ring = voxels[i].ring;
    patch.lead = std::min(voxels[i].lead, patch.count);
    patch.mean = centre_of(voxels[i], root_voxel_m) + own->mean();
    patch.spread =
        solved.eigenvectors() * solved.eigenvalues().cwiseMax(0.0).cwiseSqrt().asDiagonal();
    patches.push_back(patch);
  }
  return patches;
}

const std::vector<Eigen::Vector3d>& UnitClouds::of(std::uint32_t count) {
  if (clouds_.size() <= count) clouds_.resize(count + 1);
  if (clouds_[count].empty()) clouds_[count] = unit_cloud(count);
  return clouds_[count];
}

}  // namespace zloam::sessions
