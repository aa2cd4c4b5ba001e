#pragma once
// Planes in voxels over the last sweeps: the target that a sweep is matched against.
//
// Each voxel keeps count, sum and sum of squares of its points; a sweep that leaves the window is
// subtracted. Everything is summed in integers (the coarsest voxel's edge / 2^15 as unit, 30 um for
// 1 m), so adding and subtracting is exact: the state depends only on the sweeps in the window, not
// on how they came there, and a program that takes over from the last sweeps' messages continues
// with the same bytes. Plane fits by eigenvalues as in VoxelMap (Yuan et al. 2022), coarse to fine.
//
// The grid is rotated and shifted against odom: a floor on the boundary of two layers of voxels
// would be split into two half planes that agree with any small shift.

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <deque>
#include <span>
#include <vector>

#include "common/containers/pool.hpp"
#include "common/geometry/point.hpp"
#include "common/geometry/se3.hpp"
#include "odometry/config.hpp"
#include "odometry/voxel_sums.hpp"

namespace zloam::odometry {

struct FittedPlane {
  Eigen::Vector3d normal;  ///< unit, frame odom
  double offset;           ///< normal . centre
  double sigma_m;          ///< thickness
};

class WindowMap {
 public:
  WindowMap(const OdometryConfig& config, double range_noise_m);

  /// Adds a sweep (points in base_link at one instant), and drops the oldest when the window is
  /// full.
  void add(PointSpan points, const Pose& T_odom_base);

  using Cell = VoxelCell;
  /// The last result of find() for a point that moves little between two calls. Valid until the
  /// next add.
  struct Hint {
    Eigen::Vector3d centre_units = Eigen::Vector3d::Constant(1e30);  // of the finest voxel
    const FittedPlane* plane = nullptr;
  };

  /// The plane around each point in odom, or null; hints[k * stride] is that of point k.
  void find(std::span<const Eigen::Vector3d> points_odom, std::span<Hint> hints,
            std::size_t stride);

  void clear();
  bool empty() const { return sweeps_.empty(); }
  void set_range_noise(double range_noise_m);
  /// Whether rough surfaces count where there is no plane. With an IMU they do not: the errors of
  /// their normals would constrain a tunnel's open direction.
  void set_use_rough(bool use_rough) { use_rough_ = use_rough; }

 private:
  static constexpr int kRootBits = 15;
  static constexpr int kMaxLevels = 5;
  enum class Fit : std::uint8_t { kStale, kPlane, kRough, kNone };
  using Grid = std::array<std::int32_t, 3>;  // a point in units

  struct Voxel {
    std::uint64_t key = 0;
    VoxelSums sums;
    Fit fit = Fit::kStale;
    FittedPlane plane{};
  };
  /// The key beside the index: most look-ups end without touching a voxel.
  struct Slot {
    std::uint64_t key = 0;  // 0: free
    std::uint32_t voxel = 0;
  };
  /// Successive points of a sweep in one voxel; kept to be subtracted when the sweep leaves.
  struct Run {
    std::uint32_t voxel = 0;
    VoxelSums sums;
  };
  struct OpenRun {
    Cell cell{};
    VoxelSums sums;
  };

  int shift_of(int level) const { return kRootBits - level; }
  /// Of the finest voxels' edges.
  double half_units() const { return 0.5 * (1 << shift_of(levels_ - 1)); }
  std::size_t slot_of(std::uint64_t key) const;
  void fetch_slot(std::uint64_t key) const;
  Cell cell_of(const Grid& position, int level) const;
  std::uint32_t find_voxel(std::uint64_t key) const;
  std::uint32_t make_voxel(std::uint64_t key);
  void make_room(std::size_t voxels);
  void add_run(const VoxelRun& run, std::vector<Run>& runs);
  void close_run(int level, std::vector<Run>& runs);
  void find_voxels(std::vector<Run>& runs);
  template <int sign>
  void count(const std::vector<Run>& runs);
  bool lies_in(const Hint& hint, const Eigen::Vector3d& units) const;
  Hint looked_up(const Grid& position);
  const FittedPlane* look_up(const Grid& position);
  void fetch_slots(const Grid& position) const;
  void fetch_voxels(const Grid& position) const;
  void rebuild_table(std::size_t more_voxels);
  void enter(std::uint64_t key, std::uint32_t voxel);
  void fit(Voxel& voxel, const Cell& cell, int level);
  bool covariance(const Voxel& voxel, Eigen::Vector3d& mean, Eigen::Matrix3d& cov) const;

  OdometryConfig config_;
  double range_noise_m_;
  bool use_rough_ = true;
  double units_per_m_;
  int levels_;
  Eigen::Matrix3d R_grid_odom_;
  Eigen::Vector3d t_grid_odom_;
  Eigen::Matrix3d units_R_;  // the same two in units
  Eigen::Vector3d units_t_;
  Pool<Voxel> voxels_;
  std::vector<Slot> table_;  // open addressing, power of two
  std::size_t used_slots_ = 0;
  std::array<OpenRun, kMaxLevels> open_;
  std::vector<std::uint64_t> run_keys_;  // of the sweep that is being added
  // Of find(): the points that have left the voxels of their hints.
  struct Moved {
    std::size_t hint;
    Grid position;
  };
  std::vector<Moved> moved_;
  std::deque<std::vector<Run>> sweeps_;
};

}  // namespace zloam::odometry
