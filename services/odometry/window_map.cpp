#include "odometry/window_map.hpp"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>

#include "common/containers/thinning.hpp"
#include "common/geometry/floor.hpp"

namespace zloam::odometry {
namespace {

constexpr std::uint32_t kNoVoxel = 0xFFFFFFFFU;
constexpr std::size_t kInitialTable = 1U << 16;
constexpr std::size_t kFetchAhead = 8;
constexpr double kRoughSigmas = 3.0;

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

// Cells wrap after 2^20 voxels; positions saturate there as well.
std::int32_t saturated(double units) {
  return floor_to<std::int32_t>(std::min(std::max(units, -kMostUnits), kMostUnits));
}

std::array<std::int32_t, 3> grid_of(const Eigen::Vector3d& units) {
  return {saturated(units.x()), saturated(units.y()), saturated(units.z())};
}

}  // namespace

// The slot at which the search for a key starts.
inline std::size_t WindowMap::slot_of(std::uint64_t key) const {
  return mix(key) & (table_.size() - 1);
}

inline void WindowMap::fetch_slot(std::uint64_t key) const {
  __builtin_prefetch(&table_[slot_of(key)]);
}

WindowMap::WindowMap(const OdometryConfig& config, double range_noise_m)
    : config_(config),
      range_noise_m_(range_noise_m),
      units_per_m_((1 << kRootBits) / std::max(0.01, config.voxel_m)),
      levels_(std::clamp(config.voxel_levels, 1, kMaxLevels)),
      R_grid_odom_(exp_so3({0.1, 0.15, 0.5})),
      t_grid_odom_(0.137, 0.291, 0.173),
      units_R_(units_per_m_ * R_grid_odom_),
      units_t_(units_per_m_ * t_grid_odom_),
      table_(kInitialTable) {}

void WindowMap::set_range_noise(double range_noise_m) {
  if (range_noise_m == range_noise_m_) {
    return;
  }
  range_noise_m_ = range_noise_m;
  for (std::uint32_t i = 0; i < voxels_.size(); ++i) {
    voxels_[i].fit = Fit::kStale;
  }
}

void WindowMap::clear() {
  sweeps_.clear();
  voxels_ = {};
  table_.assign(kInitialTable, Slot{});
  used_slots_ = 0;
}

WindowMap::Cell WindowMap::cell_of(const Grid& position, int level) const {
  const int shift = shift_of(level);
  return {position[0] >> shift, position[1] >> shift, position[2] >> shift};
}

std::uint32_t WindowMap::find_voxel(std::uint64_t key) const {
  const std::size_t mask = table_.size() - 1;
  for (std::size_t slot = slot_of(key); table_[slot].key != 0; slot = (slot + 1) & mask) {
    if (table_[slot].key == key) {
      return table_[slot].voxel;
    }
  }
  return kNoVoxel;
}

// Requires free slots: make_room().
std::uint32_t WindowMap::make_voxel(std::uint64_t key) {
  const std::uint32_t found = find_voxel(key);
  if (found != kNoVoxel) {
    return found;
  }
  const std::uint32_t index = voxels_.take();
  voxels_[index].key = key;
  enter(key, index);
  return index;
}

void WindowMap::make_room(std::size_t voxels) {
  if (2 * (used_slots_ + voxels + 1) > table_.size()) {
    rebuild_table(voxels);
  }
}

// Also releases the empty voxels, which stay in the table until it fills up.
void WindowMap::rebuild_table(std::size_t more_voxels) {
  for (std::uint32_t i = 0; i < voxels_.size(); ++i) {
    if (voxels_[i].sums.count == 0 && voxels_[i].key != 0) {
      voxels_[i].key = 0;
      voxels_.release(i);
    }
  }
  const std::size_t living = voxels_.in_use();
  std::size_t capacity = kInitialTable;
  while (capacity < std::max(4 * living, 2 * (living + more_voxels + 1))) {
    capacity *= 2;
  }
  table_.assign(capacity, Slot{});
  used_slots_ = 0;
  for (std::uint32_t i = 0; i < voxels_.size(); ++i) {
    if (voxels_[i].key == 0) {
      continue;
    }
    enter(voxels_[i].key, i);
  }
}

void WindowMap::enter(std::uint64_t key, std::uint32_t voxel) {
  const std::size_t mask = table_.size() - 1;
  std::size_t slot = slot_of(key);
  while (table_[slot].key != 0) {
    slot = (slot + 1) & mask;
  }
  table_[slot] = {key, voxel};
  ++used_slots_;
}

void WindowMap::add(PointSpan points, const Pose& T_odom_base) {
  // Reuses the memory of the sweep that leaves: megabytes that the kernel would otherwise clear.
  std::vector<Run> runs;
  while (!sweeps_.empty() &&
         sweeps_.size() >= static_cast<std::size_t>(std::max(1, config_.window_sweeps))) {
    count<-1>(sweeps_.front());
    runs = std::move(sweeps_.front());
    sweeps_.pop_front();
  }
  runs.clear();
  // Reserved, because a vector that grows by doubling touches twice the memory.
  if (!sweeps_.empty()) runs.reserve(sweeps_.back().size() + sweeps_.back().size() / 8);
  const auto enough = static_cast<std::size_t>(std::max(1, config_.enough_inserted_points));
  const Thinning thinning{stride_to(enough, points.size()), 0, kCountedTogether};
  run_keys_.clear();
  const ToUnits to_units(units_R_ * T_odom_base.linear(),
                         units_R_ * T_odom_base.translation() + units_t_);
  VoxelRun run(shift_of(levels_ - 1));
  thinning.each_stretch(points.size(), [&](std::size_t begin, std::size_t end) {
    for (const Point& point : points.subspan(begin, end - begin)) {
      const UnitPoint p = to_units(point);
      if (!run.holds(p)) {
        add_run(run, runs);
        run.begin(p);
      }
      run.add(p);
    }
  });
  add_run(run, runs);
  for (int level = levels_ - 1; level >= 0; --level) {
    close_run(level, runs);
  }
  find_voxels(runs);
  count<1>(runs);
  sweeps_.push_back(std::move(runs));
}

void WindowMap::add_run(const VoxelRun& run, std::vector<Run>& runs) {
  if (run.empty()) return;
  const int finest = levels_ - 1;
  open_[static_cast<std::size_t>(finest)] = {run.cell(), run.sums()};
  close_run(finest, runs);
}

// Stores a level's run and adds its sums to the open run of the next coarser level.
void WindowMap::close_run(int level, std::vector<Run>& runs) {
  OpenRun& open = open_[static_cast<std::size_t>(level)];
  if (open.sums.count == 0) {
    return;
  }
  runs.push_back({kNoVoxel, open.sums});
  run_keys_.push_back(key_of(open.cell, level));
  if (level > 0) {
    OpenRun& parent = open_[static_cast<std::size_t>(level - 1)];
    const Cell cell = {open.cell[0] >> 1, open.cell[1] >> 1, open.cell[2] >> 1};
    if (parent.sums.count > 0 && cell != parent.cell) {
      close_run(level - 1, runs);
    }
    parent.cell = cell;
    // The child's centre lies half a child's edge to either side of the parent's.
    const std::int64_t half = 1 << (shift_of(level) - 1);
    const auto side = [&](std::size_t i) { return (open.cell[i] & 1) != 0 ? half : -half; };
    parent.sums.add_moved(open.sums, {side(0), side(1), side(2)});
  }
  open.sums = {};
}

// The voxels of successive runs are scattered in memory, so the table slot of each is prefetched
// some runs before it is needed.
void WindowMap::find_voxels(std::vector<Run>& runs) {
  make_room(runs.size());
  for (std::size_t i = 0; i < runs.size(); ++i) {
    if (i + kFetchAhead < runs.size()) {
      fetch_slot(run_keys_[i + kFetchAhead]);
    }
    runs[i].voxel = make_voxel(run_keys_[i]);
  }
}

template <int sign>
void WindowMap::count(const std::vector<Run>& runs) {
  for (std::size_t i = 0; i < runs.size(); ++i) {
    if (i + kFetchAhead < runs.size()) {
      const Voxel& later = voxels_[runs[i + kFetchAhead].voxel];
      __builtin_prefetch(&later.sums, 1);
      __builtin_prefetch(&later.fit, 1);
    }
    Voxel& voxel = voxels_[runs[i].voxel];
    voxel.sums.add<sign>(runs[i].sums);
    voxel.fit = Fit::kStale;
  }
}

bool WindowMap::lies_in(const Hint& hint, const Eigen::Vector3d& units) const {
  const double half = half_units();
  const Eigen::Vector3d off = units - hint.centre_units;
  return std::abs(off.x()) < half && std::abs(off.y()) < half && std::abs(off.z()) < half;
}

WindowMap::Hint WindowMap::looked_up(const Grid& position) {
  const double half = half_units();
  const Cell cell = cell_of(position, levels_ - 1);
  const Eigen::Vector3d corner(cell[0], cell[1], cell[2]);
  return {2.0 * half * corner + Eigen::Vector3d::Constant(half), look_up(position)};
}

// Looks up only the points that have left their hint's voxel. Their voxels are scattered in memory:
// table slots are prefetched first, then the voxels.
void WindowMap::find(std::span<const Eigen::Vector3d> points_odom, std::span<Hint> hints,
                     std::size_t stride) {
  moved_.clear();
  for (std::size_t k = 0; k < points_odom.size(); ++k) {
    const Eigen::Vector3d units = units_R_ * points_odom[k] + units_t_;
    if (!lies_in(hints[k * stride], units)) moved_.push_back({k * stride, grid_of(units)});
  }
  const std::size_t end = moved_.size();
  for (std::size_t i = 0; i < end + 2 * kFetchAhead; ++i) {
    if (i < end) fetch_slots(moved_[i].position);
    if (i >= kFetchAhead && i - kFetchAhead < end) fetch_voxels(moved_[i - kFetchAhead].position);
    if (i < 2 * kFetchAhead) continue;
    const Moved& at = moved_[i - 2 * kFetchAhead];
    hints[at.hint] = looked_up(at.position);
  }
}

void WindowMap::fetch_slots(const Grid& position) const {
  for (int level = 0; level < levels_; ++level) fetch_slot(key_of(cell_of(position, level), level));
}

void WindowMap::fetch_voxels(const Grid& position) const {
  for (int level = 0; level < levels_; ++level) {
    const std::uint32_t index = find_voxel(key_of(cell_of(position, level), level));
    if (index == kNoVoxel) return;
    __builtin_prefetch(&voxels_[index].sums.count);
    __builtin_prefetch(&voxels_[index].plane);
  }
}

// A voxel thicker than the noise may contain several surfaces, which finer voxels separate. If
// these have no plane either, the surface is rough or was built from inaccurate poses: it is used
// for want of a better one.
const FittedPlane* WindowMap::look_up(const Grid& position) {
  const FittedPlane* rough = nullptr;
  for (int level = 0; level < levels_; ++level) {
    const Cell cell = cell_of(position, level);
    const std::uint32_t index = find_voxel(key_of(cell, level));
    if (index == kNoVoxel || voxels_[index].sums.count < config_.plane_min_points) {
      break;  // a finer voxel has no more points than a coarser one
    }
    Voxel& voxel = voxels_[index];
    if (voxel.fit == Fit::kStale) {
      fit(voxel, cell, level);
    }
    if (voxel.fit == Fit::kPlane) {
      return &voxel.plane;
    }
    if (use_rough_ && voxel.fit == Fit::kRough) {
      rough = &voxel.plane;
    }
  }
  return rough;
}

bool WindowMap::covariance(const Voxel& voxel, Eigen::Vector3d& mean, Eigen::Matrix3d& cov) const {
  const VoxelSums& sums = voxel.sums;
  const auto n = static_cast<double>(sums.count);
  const double unit = 1.0 / units_per_m_;
  mean = Eigen::Vector3d(double(sums.sum[0]), double(sums.sum[1]), double(sums.sum[2])) / n;
  const auto& q = sums.square;
  Eigen::Matrix3d square;
  square << double(q[0]), double(q[1]), double(q[2]), double(q[1]), double(q[3]), double(q[4]),
      double(q[2]), double(q[4]), double(q[5]);
  cov = (square / n - mean * mean.transpose()) * (unit * unit);
  mean *= unit;
  return sums.count >= config_.plane_min_points;
}

void WindowMap::fit(Voxel& voxel, const Cell& cell, int level) {
  // Minimum ratio of the middle to the smallest eigenvalue: planes are three times wider than
  // thick.
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
  const double rough2 = std::pow(kRoughSigmas * range_noise_m_, 2);
  const double wide2 = std::pow(config_.plane_width_sigmas * range_noise_m_, 2);
  const double normal_error2 =
      values[0] / (static_cast<double>(voxel.sums.count) * std::max(1e-12, values[1]));
  if (values[0] > rough2 || values[1] < wide2 || values[1] < kAspect * values[0] ||
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
  voxel.fit = values[0] > thick2 ? Fit::kRough : Fit::kPlane;
}

}  // namespace zloam::odometry
