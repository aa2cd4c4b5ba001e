#pragma once
// Scan to map: keeps T_map_odom, the map in tiles and the path of mapped poses.
//
// The points lie in cubes, and a window of cubes follows the sensor, as in LOAM (Zhang and Singh,
// LOAM: Lidar Odometry and Mapping in Real-time, RSS 2014, section VI). A sweep is matched against
// voxel planes (voxel_planes_method.hpp) through an interface (method.hpp): prediction, insertion
// policy, tiles and path do not depend on the method.
//
// Frames: all inputs are in base_link at one instant of the sweep; poses are T_map_base
// at that instant. The map's origin is the first pose of base_link in odom. Tangents
// are (translation m, rotation rad), right perturbation: T = T0 * Exp(x), i.e. in
// base_link.

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "common/geometry/health.hpp"
#include "common/geometry/inertial_step.hpp"
#include "common/geometry/map_layer.hpp"
#include "common/geometry/point.hpp"
#include "common/geometry/se3.hpp"
#include "common/plane_map/saved_voxel.hpp"
#include "mapping/config.hpp"
#include "mapping/submap_builder.hpp"

namespace zloam::mapping {

/// One sweep as odometry hands it on. Spans are only read during the call.
struct MappingInput {
  std::uint64_t sweep = 0;
  /// time of the sweep's first point, ns since the Unix epoch
  std::int64_t stamp_ns = 0;
  /// the instant of pose and points, ns after the sweep's first point
  std::uint32_t instant_ns = 0;
  /// time covered by the points, ns
  std::uint32_t period_ns = 0;
  /// one higher when the odom frame could not be continued: the new one is searched for around the
  /// last pose
  std::uint32_t odom_epoch = 0;
  Pose T_odom_base = Pose::Identity();
  /// twist with which the points were moved to the instant, m/s and rad/s, body frame
  Vector6 twist_per_s = Vector6::Zero();
  /// of the odometry's motion since the sweep mapped before, tangent at base_link
  Matrix6 step_covariance = Matrix6::Zero();
  /// the IMU's preintegrated motion since the sweep before; nothing when that was not
  /// mapped
  std::optional<InertialStep> inertial;
  Pose T_base_lidar = Pose::Identity();
  /// frame base_link at the instant; time_ns is still each point's own
  PointSpan edges;
  PointSpan planes;
  Health health = Health::kOk;
  bool degenerate = false;
  /// longest time without odometry since the sweep mapped before, s; nothing: odometry came for
  /// mapped sweeps only
  std::optional<double> unwatched_s;
  double range_noise_m = 0.02;
  /// above 1: only one of this many consecutive poses has points, those of a whole revolution of a
  /// scan that arrives in slices
  std::uint32_t slices = 1;

  bool points_follow() const { return slices > 1 && planes.empty(); }
  /// Whether mapping.every leaves it to the mapper: a turn of slices comes once a second, with a
  /// sweep of any number.
  bool is_mapped(std::uint32_t every) const { return slices > 1 || sweep % every == 0; }
};

/// Cube (i, j, k) spans [i, i+1) * tile edge on x, likewise y and z, frame map.
struct TileIndex {
  std::int32_t i = 0, j = 0, k = 0;
  auto operator<=>(const TileIndex&) const = default;
};

struct TileId {
  TileIndex index;
  Layer layer = Layer::kEdge;
  auto operator<=>(const TileId&) const = default;
};

struct Tile {
  TileId id;
  double edge_m = 0.0;
  /// grows with each sweep that changed the tile
  std::uint64_t version = 0;
  /// frame map, in the order in which their voxels were first hit
  std::vector<MapPoint> points;
  /// number of returns behind each point
  std::vector<std::uint32_t> counts;
};

/// A method's counts in one cube, to continue from after a restart.
struct VoxelTile {
  /// of a separate grid
  TileIndex index;
  double edge_m = 0.0;
  /// increases each time the cube is published
  std::uint64_t version = 0;
  double root_voxel_m = 0.0;
  int levels = 0;
  double range_noise_m = 0.0;
  /// parents before children
  std::vector<plane_map::SavedVoxel> voxels;
};

/// What a killed mapper left: its map and its last pose.
struct SavedMap {
  std::vector<Tile> tiles;
  std::vector<VoxelTile> voxels;
  std::int64_t instant_ns = 0;
  std::uint32_t odom_epoch = 0;
  Pose T_map_base = Pose::Identity();
  Vector6 twist_per_s = Vector6::Zero();
  /// of that odometry epoch; nothing: the next sweep is searched for around T_map_base
  std::optional<Pose> T_map_odom;
  /// the robot was found in it; if not, a map to be extended is fixed until the robot is found
  bool found = true;
};

/// The least constrained direction. Vectors are unit in base_link, zero when none is degenerate.
struct Degeneracy {
  bool degenerate = false;
  Eigen::Vector3d weak_translation = Eigen::Vector3d::Zero();
  Eigen::Vector3d weak_rotation = Eigen::Vector3d::Zero();
  /// one sigma along that direction: m when a translation is degenerate (or none), else rad
  double sigma_measured = 0.0;
  double sigma_predicted = 0.0;
  /// mean squared share of the normals along the least constrained translation, 0..1
  double share = 0.0;
};

struct MappingResult {
  std::uint64_t sweep = 0;
  Pose T_map_odom = Pose::Identity();
  Pose T_map_base = Pose::Identity();
  /// of T_map_base, tangent at base_link
  Matrix6 covariance = Matrix6::Zero();
  Health health = Health::kOk;
  bool inserted = false;
  Degeneracy degeneracy;
  std::uint32_t iterations = 0;
  std::uint32_t correspondences = 0;
  /// rms of the residuals after the last iteration, m
  double residual_m = 0.0;
  /// tiles changed by this sweep, ascending; empty when not inserted
  std::vector<TileId> changed;
  /// tiles that left the window at this sweep, as they were; the mapper keeps them as part of the
  /// whole map
  std::vector<Tile> evicted;
  /// why the sweep was not inserted, empty when it was
  std::string reason;
  /// the submap that ended with this sweep
  std::optional<Submap> submap;
};

struct PathPose {
  std::uint64_t sweep = 0;
  /// ns since the Unix epoch
  std::int64_t instant_ns = 0;
  Pose T_map_base = Pose::Identity();
};

class MappingMethod;

class Mapper {
 public:
  explicit Mapper(const MappingConfig& config);
  ~Mapper();
  Mapper(Mapper&&) noexcept;
  Mapper& operator=(Mapper&&) noexcept;

  /// Matches one sweep, corrects T_map_odom and inserts it where the policy allows. Sweeps must
  /// come in ascending order. Points that are not finite are left out. Never throws on bad data:
  /// the result's health says what was wrong, and the pose is then the prediction.
  MappingResult process(const MappingInput& input);

  /// From the next sweep on. Cubes, leaves and voxels of an existing map keep their sizes.
  void configure(const MappingConfig& config);

  /// Empties map and path; the next sweep initializes a new map at its predicted pose.
  void reset();

  /// Restores what another instance left. Nothing is inserted before a sweep was matched against it
  /// (config.bridge_*); without points in it, the next sweep initializes a map in the same frame.
  void restore(const SavedMap& saved);
  /// The odometry may have been interrupted: the next sweep is searched for as after a new epoch,
  /// around the odometry's pose.
  void expect_break();
  /// The next sweep is of another run: its number does not follow. The map goes on.
  void new_run();
  /// After restore(): re-inserts a sweep that the earlier instance inserted after the map was
  /// saved. state: of that instance after this sweep, or empty.
  void insert_again(const MappingInput& input, const Pose& T_map_odom,
                    std::span<const std::uint64_t> state);
  /// The state beside the map, for an instance of the same program that continues from here; empty
  /// while it would be incomplete, as during a search.
  std::vector<std::uint64_t> state();
  /// After restore() and insert_again(): continues as the instance whose state it is. Applied with
  /// the next sweep; a state that is not of this program is ignored.
  void resume(std::span<const std::uint64_t> state);
  /// Sets the pose of the next sweep, given by a user: the sweep is searched for around it even if
  /// the robot was already found. Nothing is inserted before it is found.
  void place(const Pose& T_map_base);
  /// The unfinished submap, at the end of a run; nothing when too little was seen.
  std::optional<Submap> finish_submap();
  /// The method's counts in cubes that have grown by more than this share since they were returned
  /// last (0: all cubes that changed), ascending.
  std::vector<VoxelTile> take_changed_voxels(double growth);

  const Pose& T_map_odom() const;
  const std::vector<PathPose>& path() const;
  /// The points of one tile, also of one that left the window; empty when there is none.
  std::optional<Tile> tile(const TileId& id) const;
  /// All points ever counted in a tile in memory; 0: there is no such tile.
  std::uint64_t tile_count(const TileId& id) const;
  /// All tiles that hold points, ascending (i, j, k, layer).
  std::vector<TileId> tiles() const;
  /// The local map around the last pose, in the order of cloud().
  std::vector<LayeredPoint> surround() const;
  /// The whole map in the order (tile, layer, insertion).
  std::vector<LayeredPoint> cloud() const;
  /// The part of cloud() that lies in one tile.
  std::vector<LayeredPoint> tile_points(const TileId& id) const;
  std::size_t point_count() const;
  /// What the map lacks, or what is wrong with the tiles that left the window, a sentence; empty:
  /// nothing.
  std::string archive_fault() const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace zloam::mapping
