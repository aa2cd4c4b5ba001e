#include "odometry/window_map.hpp"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>

#include "common/containers/thinning.hpp"
#include "common/geometry/floor.hpp"
#include "common/geometry/lanes.hpp"

namespace zloam::odometry {
namespace {

constexpr std::uint32_t kNoVoxel = 0xFFFFFFFFU;
constexpr std::size_t kInitialTable = 1U << 16;
constexpr std::size_t kFetchAhead = 8;
constexpr double kMostUnits = 2.0e9;
constexpr double kNowhere = 1e30;

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

// A point in units, rounded down: whole numbers, which doubles hold exactly.
struct UnitPoint {
  Double2 xy;
  Double2 z;  // and 0
};

// From base_link to units of the grid.
class ToUnits {
 public:
  ToUnits(const Eigen::Matrix3d& turn, const Eigen::Vector3d& shift)
      : shift_{halves_of(shift)},
        columns_{halves_of(turn.col(0)), halves_of(turn.col(1)), halves_of(turn.col(2))} {}

  UnitPoint operator()(const Point& p) const {
    const double x = p.x, y = p.y, z = p.z;
    const auto [cx, cy, cz] = columns_;
    return {whole(cx.xy * x + (cy.xy * y + cz.xy * z) + shift_.xy),
            whole(cx.z * x + (cy.z * y + cz.z * z) + shift_.z)};
  }

 private:
  static UnitPoint halves_of(const Eigen::Vector3d& v) {
    return {Double2{v.x(), v.y()}, Double2{v.z(), 0.0}};
  }
  static Double2 whole(Double2 units) {
    const Double2 most = Double2{} + kMostUnits;
    units = units < -most ? -most : units;
    return floor_of(units > most ? most : units);
  }

  UnitPoint shift_;
  std::array<UnitPoint, 3> columns_;
};

}  // namespace

// Points come ring by ring, so successive ones mostly share their finest voxel: they are summed
// here, two numbers at once, and the voxels are touched once a run. The sums stay far below 2^53
// and are exact.
class WindowMap::FinestRun {
 public:
  explicit FinestRun(int shift) : shift_(shift), half_(1 << (shift - 1)) {}

  bool empty() const { return z_count_[1] == 0.0; }
  bool holds(const UnitPoint& p) const {
    return all_within(p.xy - centre_.xy, p.z - centre_.z, half_);
  }
  void begin(const UnitPoint& p) {
    *this = FinestRun(shift_);
    const Grid at = {static_cast<std::int32_t>(p.xy[0]), static_cast<std::int32_t>(p.xy[1]),
                     static_cast<std::int32_t>(p.z[0])};
    cell_ = {at[0] >> shift_, at[1] >> shift_, at[2] >> shift_};
    const auto centre = [&](std::size_t i) { return 2.0 * half_ * cell_[i] + half_; };
    centre_ = {Double2{centre(0), centre(1)}, Double2{centre(2), 0.0}};
  }
  void add(const UnitPoint& p) {
    const Double2 xy = p.xy - centre_.xy;
    const Double2 z = p.z - centre_.z;
    xy_ += xy;
    z_count_ += Double2{z[0], 1.0};
    xx_yy_ += xy * xy;
    xz_yz_ += xy * z[0];
    xy_zz_ += Double2{xy[0], z[0]} * Double2{xy[1], z[0]};
  }
  OpenRun run() const {
    const auto whole = [](double x) { return static_cast<std::int64_t>(x); };
    Sums sums;
    sums.sum = {whole(xy_[0]), whole(xy_[1]), whole(z_count_[0])};
    sums.square = {whole(xx_yy_[0]), whole(xy_zz_[0]), whole(xz_yz_[0]),
                   whole(xx_yy_[1]), whole(xz_yz_[1]), whole(xy_zz_[1])};
    sums.count = whole(z_count_[1]);
    return {cell_, sums};
  }

 private:
  int shift_;
  double half_;
  Cell cell_{};
  UnitPoint centre_{Double2{} + kNowhere, Double2{} + kNowhere};
  Double2 xy_{}, z_count_{}, xx_yy_{}, xz_yz_{}, xy_zz_{};
};

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
  for (std::size_t slot = mix(key) & mask; table_[slot].key != 0; slot = (slot + 1) & mask) {
    if (table_[slot].key == key) {
      return table_[slot].voxel;
    }
  }
  return kNoVoxel;
}

// There must be room.
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

// Empty voxels stay in the table until it fills up; here they are given back.
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
  std::size_t slot = mix(key) & mask;
  while (table_[slot].key != 0) {
    slot = (slot + 1) & mask;
  }
  table_[slot] = {key, voxel};
  ++used_slots_;
}

template <int sign>
void WindowMap::Sums::add(const Sums& other) {
  for (std::size_t i = 0; i < 3; ++i) {
    sum[i] += sign * other.sum[i];
  }
  for (std::size_t i = 0; i < 6; ++i) {
    square[i] += sign * other.square[i];
  }
  count += sign * other.count;
}

// The sum of (p + o)(p + o)^T is that of p p^T and o s^T + s o^T + n o o^T.
void WindowMap::Sums::add_moved(const Sums& other, const std::array<std::int64_t, 3>& o) {
  const auto& s = other.sum;
  std::array<std::int64_t, 3> moved;
  for (std::size_t i = 0; i < 3; ++i) {
    moved[i] = s[i] + other.count * o[i];
    sum[i] += moved[i];
  }
  square[0] += other.square[0] + o[0] * (s[0] + moved[0]);
  square[1] += other.square[1] + o[0] * s[1] + o[1] * moved[0];
  square[2] += other.square[2] + o[0] * s[2] + o[2] * moved[0];
  square[3] += other.square[3] + o[1] * (s[1] + moved[1]);
  square[4] += other.square[4] + o[1] * s[2] + o[2] * moved[1];
  square[5] += other.square[5] + o[2] * (s[2] + moved[2]);
  count += other.count;
}

void WindowMap::add(PointSpan points, const Pose& T_odom_base) {
  // The memory of the sweep that leaves: megabytes, which the kernel would else clear each time.
  std::vector<Run> runs;
  while (!sweeps_.empty() &&
         sweeps_.size() >= static_cast<std::size_t>(std::max(1, config_.window_sweeps))) {
    count<-1>(sweeps_.front());
    runs = std::move(sweeps_.front());
    sweeps_.pop_front();
  }
  runs.clear();
  // A vector that grows by doubling touches twice the memory.
  if (!sweeps_.empty()) runs.reserve(sweeps_.back().size() + sweeps_.back().size() / 8);
  const auto enough = static_cast<std::size_t>(std::max(1, config_.enough_inserted_points));
  const Thinning thinning{stride_to(enough, points.size()), 0, kCountedTogether};
  run_keys_.clear();
  const ToUnits to_units(units_R_ * T_odom_base.linear(),
                         units_R_ * T_odom_base.translation() + units_t_);
  FinestRun run(shift_of(levels_ - 1));
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

void WindowMap::add_run(const FinestRun& run, std::vector<Run>& runs) {
  if (run.empty()) return;
  const int finest = levels_ - 1;
  open_[static_cast<std::size_t>(finest)] = run.run();
  close_run(finest, runs);
}

// Keeps a level's run and hands it on to the level above.
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

// The voxels of successive runs lie anywhere in memory, so each is fetched some runs before it is
// needed.
void WindowMap::find_voxels(std::vector<Run>& runs) {
  make_room(runs.size());
  const std::size_t mask = table_.size() - 1;
  for (std::size_t i = 0; i < runs.size(); ++i) {
    if (i + kFetchAhead < runs.size()) {
      __builtin_prefetch(&table_[mix(run_keys_[i + kFetchAhead]) & mask]);
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

const FittedPlane* WindowMap::find(const Eigen::Vector3d& point_odom, Hint& hint) {
  const Eigen::Vector3d units = units_R_ * point_odom + units_t_;
  const double half = 0.5 * (1 << shift_of(levels_ - 1));
  const Eigen::Vector3d off = units - hint.centre_units;
  if (!(std::abs(off.x()) < half && std::abs(off.y()) < half && std::abs(off.z()) < half)) {
    const Grid position = grid_of(units);
    const Cell cell = cell_of(position, levels_ - 1);
    const Eigen::Vector3d corner(cell[0], cell[1], cell[2]);
    hint = {2.0 * half * corner + Eigen::Vector3d::Constant(half), look_up(position)};
  }
  return hint.plane;
}

const FittedPlane* WindowMap::look_up(const Grid& position) {
  for (int level = 0; level < levels_; ++level) {
    const Cell cell = cell_of(position, level);
    const std::uint32_t index = find_voxel(key_of(cell, level));
    if (index == kNoVoxel || voxels_[index].sums.count < config_.plane_min_points) {
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
  const Sums& sums = voxel.sums;
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
  const double normal_error2 = values[0] / (static_cast<double>(voxel.sums.count) * std::max(1e-12, values[1]));
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
