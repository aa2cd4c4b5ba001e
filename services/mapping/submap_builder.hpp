#pragma once
// Cuts the mapped sweeps into submaps: the points seen along a few metres of way, in one frame that
// no later correction deforms. The graph of loops (services/graph) consists of them.
//
// A submap holds consecutive sweeps of one stretch, all of them found in the map, so that it is as
// rigid as the map matching is exact. It ends after a distance, never after a time: standing still
// adds nothing new. The choice of sweeps depends on nothing but the sweeps.

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <vector>

#include "common/containers/flat_index.hpp"
#include "common/geometry/point.hpp"
#include "common/geometry/se3.hpp"
#include "common/geometry/submap.hpp"

namespace zloam::mapping {

/// One mapped sweep.
struct SubmapInput {
  std::uint64_t sweep = 0;
  std::int64_t instant_ns = 0;
  Pose T_map_base = Pose::Identity();
  Matrix6 covariance = Matrix6::Zero();
  /// its pose was found in the map
  bool found = false;
  /// the points left a direction unconstrained
  bool degenerate = false;
  double range_noise_m = 0.0;
  /// of the sensor, base_link
  Eigen::Vector3d origin_base = Eigen::Vector3d::Zero();
  /// frame base_link at the instant
  PointSpan edges, planes;
};

class SubmapBuilder {
 public:
  /// way_m: of a submap; 0: there are none.
  explicit SubmapBuilder(double way_m) : way_m_(way_m) {}

  /// Takes sweeps in order. Returns the submap that ends with this one, if one does.
  std::optional<Submap> add(const SubmapInput& input);
  /// The unfinished submap, at the end of a run; nothing when too little was seen.
  std::optional<Submap> finish();
  /// The next sweep is of another run in the same map: its number does not follow.
  void new_run();
  /// From the next submap on.
  void configure(double way_m) { way_m_ = way_m; }

 private:
  struct Voxel {
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    double intensity = 0.0;
    std::uint32_t count = 0;
    // Groups of sweeps that hit it, a bit each.
    std::uint64_t hits = 0;
  };
  struct Step {
    std::uint64_t sweep;
    std::int64_t instant_ns;
    Pose T_map_base;
    double way_m;
    // Of this pose, of what was left unconstrained since the frame of the submap before, and of all
    // of the motion since then.
    Matrix6 own, open, covariance;
    double since_m;
    bool connected;
    Eigen::Vector3d origin_base;
  };

  void move(const SubmapInput& input);
  void take(PointSpan points, const Pose& T_first_base, std::uint64_t hit);
  std::uint64_t next_hit();
  std::vector<Eigen::Vector3d> origins(const Pose& T_submap_map) const;
  Submap close();
  void clear();

  double way_m_;
  // Of the unfinished submap; points in the frame of its first sweep.
  std::vector<Step> steps_;
  FlatIndex places_;
  std::vector<Voxel> voxels_;
  // Sweeps in a group.
  std::size_t group_ = 1;
  double range_noise_m_ = 0.0;
  // Since the frame of the submap before.
  std::optional<Pose> T_map_base_before_;
  std::optional<std::uint64_t> before_sweep_;
  Eigen::Vector3d counted_at_ = Eigen::Vector3d::Zero();
  Eigen::Matrix3d counted_turn_ = Eigen::Matrix3d::Identity();
  Matrix6 frame_ = Matrix6::Zero();
  Matrix6 open_ = Matrix6::Zero();
  Matrix6 unfound_ = Matrix6::Zero();
  double since_m_ = 0.0;
  bool connected_ = true;
};

}  // namespace zloam::mapping
