#pragma once
// Planes in voxels over the last sweeps: the target of Target::kRecentSweeps.
//
// Each voxel keeps count, sum and sum of squares of its points; a sweep that leaves the window is
// subtracted. Everything is summed in integers (the coarsest voxel's edge / 2^15 as unit, 30 um for
// 1 m), so adding and subtracting is exact: the state depends only on the sweeps in the window, not
// on how they came there, and a program that takes over from the last sweeps' messages continues
// with the same bytes. Plane fits by eigenvalues as in VoxelMap (Yuan et al. 2022), coarse to fine.
//
// The grid is turned and shifted against odom: a floor on the boundary of two layers of voxels
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

  using Cell = std::array<std::int32_t, 3>;
  /// What find() found last for a point that moves little between two calls.
  struct Hint {
    Eigen::Vector3d centre_units = Eigen::Vector3d::Constant(1e30);  // of the finest voxel
    const FittedPlane* plane = nullptr;
  };

  /// The plane around a point in odom, or null. Valid until the next add, like the hint.
  const FittedPlane* find(const Eigen::Vector3d& point_odom, Hint& hint);

  void clear();
  bool empty() const { return sweeps_.empty(); }
  void set_range_noise(double range_noise_m);

 private:
  static constexpr int kRootBits = 15;
  static constexpr int kMaxLevels = 5;
  enum class Fit : std::uint8_t { kStale, kPlane, kNone };
  using Grid = std::array<std::int32_t, 3>;  // a point in units

  /// Moments of points relative to their voxel's centre, in units.
  struct Sums {
    std::array<std::int64_t, 3> sum{};
    std::array<std::int64_t, 6> square{};  // xx xy xz yy yz zz
    std::int64_t count = 0;

    template <int sign>
    void add(const Sums& other);
    /// Points relative to an origin that lies at `offset` from this one's.
    void add_moved(const Sums& other, const std::array<std::int64_t, 3>& offset);
  };
  struct Voxel {
    std::uint64_t key = 0;
    Sums sums;
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
    Sums sums;
  };
  struct OpenRun {
    Cell cell{};
    Sums sums;
  };

  int shift_of(int level) const { return kRootBits - level; }
  Cell cell_of(const Grid& position, int level) const;
  std::uint32_t find_voxel(std::uint64_t key) const;
  std::uint32_t make_voxel(std::uint64_t key);
  void make_room(std::size_t voxels);
  class FinestRun;
  void add_run(const FinestRun& run, std::vector<Run>& runs);
  void close_run(int level, std::vector<Run>& runs);
  void find_voxels(std::vector<Run>& runs);
  template <int sign>
  void count(const std::vector<Run>& runs);
  const FittedPlane* look_up(const Grid& position);
  void rebuild_table(std::size_t more_voxels);
  void enter(std::uint64_t key, std::uint32_t voxel);
  void fit(Voxel& voxel, const Cell& cell, int level);
  bool covariance(const Voxel& voxel, Eigen::Vector3d& mean, Eigen::Matrix3d& cov) const;

  OdometryConfig config_;
  double range_noise_m_;
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
  std::deque<std::vector<Run>> sweeps_;
};

}  // namespace zloam::odometry
