#include "odometry/window_map.hpp"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>

namespace zloam::odometry {
namespace {

constexpr std::uint32_t kNoVoxel = 0xFFFFFFFFU;
constexpr std::size_t kInitialTable = 1U << 16;

std::uint64_t key_of(const std::array<std::int32_t, 3>& cell, int level) {
  constexpr std::uint64_t kMask = (1U << 20) - 1;
  const auto part = [](std::int32_t v) { return static_cast<std::uint64_t>(v) & kMask; };
  return part(cell[0]) | part(cell[1]) << 20 | part(cell[2]) << 40 |
         static_cast<std::uint64_t>(level + 1) << 60;
}

// Finaliser of MurmurHash3 (public domain): spreads neighbouring cells.
std::uint64_t mix(std::uint64_t x) {
  x ^= x >> 33;
  x *= 0xff51afd7ed558ccdULL;
  x ^= x >> 33;
  x *= 0xc4ceb9fe1a85ec53ULL;
  return x ^ (x >> 33);
}

}  // namespace

WindowMap::WindowMap(const OdometryConfig& config, double range_noise_m)
    : config_(config),
      range_noise_m_(range_noise_m),
      units_per_m_((1 << kRootBits) / std::max(0.01, config.voxel_m)),
      levels_(std::clamp(config.voxel_levels, 1, kMaxLevels)),
      R_grid_odom_(exp_so3({0.1, 0.15, 0.5})),
      t_grid_odom_(0.137, 0.291, 0.173),
      table_(kInitialTable, 0) {}

void WindowMap::set_range_noise(double range_noise_m) {
  if (range_noise_m == range_noise_m_) {
    return;
  }
  range_noise_m_ = range_noise_m;
  for (Voxel& voxel : voxels_) {
    voxel.fit = Fit::kStale;
  }
}

void WindowMap::clear() {
  sweeps_.clear();
  voxels_.clear();
  free_.clear();
  table_.assign(kInitialTable, 0);
  used_slots_ = 0;
}

WindowMap::Grid WindowMap::to_grid(const Eigen::Vector3d& point_odom) const {
  const Eigen::Vector3d g = (R_grid_odom_ * point_odom + t_grid_odom_) * units_per_m_;
  // Cells wrap after 2^20 voxels; positions saturate there as well.
  constexpr double kLimit = 2.0e9;
  Grid out;
  for (int i = 0; i < 3; ++i) {
    out[static_cast<std::size_t>(i)] =
        static_cast<std::int32_t>(std::floor(std::clamp(g[i], -kLimit, kLimit)));
  }
  return out;
}

WindowMap::Cell WindowMap::cell_of(const Grid& position, int level) const {
  const int shift = shift_of(level);
  return {position[0] >> shift, position[1] >> shift, position[2] >> shift};
}

std::uint32_t WindowMap::find_voxel(const Cell& cell, int level) const {
  const std::uint64_t key = key_of(cell, level);
  const std::size_t mask = table_.size() - 1;
  for (std::size_t slot = mix(key) & mask; table_[slot] != 0; slot = (slot + 1) & mask) {
    if (voxels_[table_[slot] - 1].key == key) {
      return table_[slot] - 1;
    }
  }
  return kNoVoxel;
}

std::uint32_t WindowMap::make_voxel(const Cell& cell, int level) {
  const std::uint32_t found = find_voxel(cell, level);
  if (found != kNoVoxel) {
    return found;
  }
  if (2 * (used_slots_ + 1) > table_.size()) {
    const std::size_t living = voxels_.size() - free_.size();
    rebuild_table(4 * living > table_.size() ? 2 * table_.size() : table_.size());
  }
  std::uint32_t index;
  if (free_.empty()) {
    index = static_cast<std::uint32_t>(voxels_.size());
    voxels_.emplace_back();
  } else {
    index = free_.back();
    free_.pop_back();
  }
  voxels_[index] = Voxel{};
  voxels_[index].key = key_of(cell, level);
  const std::size_t mask = table_.size() - 1;
  std::size_t slot = mix(voxels_[index].key) & mask;
  while (table_[slot] != 0) {
    slot = (slot + 1) & mask;
  }
  table_[slot] = index + 1;
  ++used_slots_;
  return index;
}

// Empty voxels stay in the table until it fills up; here they are given back.
void WindowMap::rebuild_table(std::size_t capacity) {
  for (std::uint32_t i = 0; i < voxels_.size(); ++i) {
    if (voxels_[i].count == 0 && voxels_[i].key != 0) {
      voxels_[i].key = 0;
      free_.push_back(i);
    }
  }
  const std::size_t living = voxels_.size() - free_.size();
  while (capacity < 4 * living) {
    capacity *= 2;
  }
  table_.assign(capacity, 0);
  used_slots_ = 0;
  for (std::uint32_t i = 0; i < voxels_.size(); ++i) {
    if (voxels_[i].key == 0) {
      continue;
    }
    std::size_t slot = mix(voxels_[i].key) & (capacity - 1);
    while (table_[slot] != 0) {
      slot = (slot + 1) & (capacity - 1);
    }
    table_[slot] = i + 1;
    ++used_slots_;
  }
}

void WindowMap::change(Voxel& voxel, const Grid& position, int level, int sign) {
  const std::int32_t mask = (1 << shift_of(level)) - 1;
  const std::int32_t half = 1 << (shift_of(level) - 1);
  const std::int64_t x = (position[0] & mask) - half;
  const std::int64_t y = (position[1] & mask) - half;
  const std::int64_t z = (position[2] & mask) - half;
  voxel.sum[0] += sign * x;
  voxel.sum[1] += sign * y;
  voxel.sum[2] += sign * z;
  voxel.square[0] += sign * x * x;
  voxel.square[1] += sign * x * y;
  voxel.square[2] += sign * x * z;
  voxel.square[3] += sign * y * y;
  voxel.square[4] += sign * y * z;
  voxel.square[5] += sign * z * z;
  voxel.count += sign;
  voxel.fit = Fit::kStale;
}

void WindowMap::add(PointSpan points, const Pose& T_odom_base) {
  while (!sweeps_.empty() &&
         sweeps_.size() >= static_cast<std::size_t>(std::max(1, config_.window_sweeps))) {
    remove_oldest();
  }
  const auto wanted = static_cast<std::size_t>(std::max(1, config_.max_inserted_points));
  const std::size_t stride = std::max<std::size_t>(1, (points.size() + wanted - 1) / wanted);
  SweepEntries entries;
  entries.reserve(points.size() / stride + 1);
  // Successive points mostly share their voxels.
  std::array<Cell, kMaxLevels> last_cell{};
  Entry entry{};
  bool first = true;
  for (std::size_t i = 0; i < points.size(); i += stride) {
    entry.position = to_grid(T_odom_base * points[i].position().cast<double>());
    for (int level = 0; level < levels_; ++level) {
      const auto l = static_cast<std::size_t>(level);
      const Cell cell = cell_of(entry.position, level);
      if (first || cell != last_cell[l]) {
        entry.voxel[l] = make_voxel(cell, level);
        last_cell[l] = cell;
      }
      change(voxels_[entry.voxel[l]], entry.position, level, 1);
    }
    first = false;
    entries.push_back(entry);
  }
  sweeps_.push_back(std::move(entries));
}

void WindowMap::remove_oldest() {
  for (const Entry& entry : sweeps_.front()) {
    for (int level = 0; level < levels_; ++level) {
      change(voxels_[entry.voxel[static_cast<std::size_t>(level)]], entry.position, level, -1);
    }
  }
  sweeps_.pop_front();
}

const FittedPlane* WindowMap::find(const Eigen::Vector3d& point_odom) {
  const Grid position = to_grid(point_odom);
  for (int level = 0; level < levels_; ++level) {
    const Cell cell = cell_of(position, level);
    const std::uint32_t index = find_voxel(cell, level);
    if (index == kNoVoxel || voxels_[index].count < config_.plane_min_points) {
      return nullptr;  // a finer voxel has no more points than a coarser one
    }
    Voxel& voxel = voxels_[index];
    if (voxel.fit == Fit::kStale) {
      fit(voxel, cell, level);
    }
    if (voxel.fit == Fit::kPlane) {
      return &voxel.plane;
    }
  }
  return nullptr;
}

bool WindowMap::covariance(const Voxel& voxel, Eigen::Vector3d& mean, Eigen::Matrix3d& cov) const {
  const double n = voxel.count;
  const double unit = 1.0 / units_per_m_;
  mean = Eigen::Vector3d(double(voxel.sum[0]), double(voxel.sum[1]), double(voxel.sum[2])) / n;
  const auto& q = voxel.square;
  Eigen::Matrix3d square;
  square << double(q[0]), double(q[1]), double(q[2]), double(q[1]), double(q[3]), double(q[4]),
      double(q[2]), double(q[4]), double(q[5]);
  cov = (square / n - mean * mean.transpose()) * (unit * unit);
  mean *= unit;
  return voxel.count >= config_.plane_min_points;
}

void WindowMap::fit(Voxel& voxel, const Cell& cell, int level) {
  // Planes must be well longer than wide is thick.
  constexpr double kAspect = 9.0;
  voxel.fit = Fit::kNone;
  Eigen::Vector3d mean;
  Eigen::Matrix3d cov;
  if (!covariance(voxel, mean, cov)) {
    return;
  }
  Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver;
  solver.computeDirect(cov);
  const Eigen::Vector3d values = solver.eigenvalues().cwiseMax(0.0);
  const double thick2 = std::pow(config_.plane_thickness_sigmas * range_noise_m_, 2);
  const double wide2 = std::pow(config_.plane_width_sigmas * range_noise_m_, 2);
  const double normal_error2 = values[0] / (voxel.count * std::max(1e-12, values[1]));
  if (values[0] > thick2 || values[1] < wide2 || values[1] < kAspect * values[0] ||
      normal_error2 > config_.plane_normal_error_rad * config_.plane_normal_error_rad) {
    return;
  }
  const double edge_m = (1 << shift_of(level)) / units_per_m_;
  const Eigen::Vector3d corner(cell[0], cell[1], cell[2]);
  const Eigen::Vector3d centre_grid = (corner.array() + 0.5).matrix() * edge_m + mean;
  voxel.plane.normal = (R_grid_odom_.transpose() * solver.eigenvectors().col(0)).normalized();
  voxel.plane.offset =
      voxel.plane.normal.dot(R_grid_odom_.transpose() * (centre_grid - t_grid_odom_));
  voxel.plane.sigma_m = std::sqrt(values[0]);
  voxel.fit = Fit::kPlane;
}

}  // namespace zloam::odometry
