#pragma once
// Scan to map: keeps T_map_odom, the map in tiles and the path of mapped poses.
//
// The points lie in cubes and a window of them that follows the sensor, as in LOAM (Zhang and
// Singh, LOAM: Lidar Odometry and Mapping in Real-time, RSS 2014, section VI). A sweep is matched
// against voxel planes (voxel_planes_method.hpp) through an interface (method.hpp): prediction,
// insertion policy, tiles and path do not know how.
//
// Frames: everything that comes in is in base_link at one instant of the sweep; poses are
// T_map_base at that instant. The map's origin is the first pose of base_link in odom.
// Tangents are (translation m, rotation rad), right perturbation: T = T0 * Exp(x), i.e. in
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
  /// +1 when the odom frame could not be continued: the new one is searched for around the last
  /// pose
  std::uint32_t odom_epoch = 0;
  Pose T_odom_base = Pose::Identity();
  /// twist with which the points were moved to the instant, m/s and rad/s, body frame
  Vector6 twist_per_s = Vector6::Zero();
  /// of the odometry's motion since the sweep mapped before, tangent at base_link
  Matrix6 step_covariance = Matrix6::Zero();
  /// the IMU's preintegrated motion since the sweep before; none where that was not
  /// mapped
  std::optional<InertialStep> inertial;
  Pose T_base_lidar = Pose::Identity();
  /// frame base_link at the instant; time_ns is still each point's own
  PointSpan edges;
  PointSpan planes;
  Health health = Health::kOk;
  bool degenerate = false;
  double range_noise_m = 0.02;
  /// above 1: of so many poses in a row one has points, those of a whole turn of a scan that comes
  /// in slices
  std::uint32_t slices = 1;

  bool points_follow() const { return slices > 1 && planes.empty(); }
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
  /// returns that made each point
  std::vector<std::uint32_t> counts;
};

/// What a method has counted in one cube, to go on with after a restart.
struct VoxelTile {
  /// of a grid of its own
  TileIndex index;
  double edge_m = 0.0;
  /// grows each time that it is handed out
  std::uint64_t version = 0;
  double root_voxel_m = 0.0;
  int levels = 0;
  double range_noise_m = 0.0;
  /// parents before children
  std::vector<plane_map::SavedVoxel> voxels;
};

/// What a mapper that was killed left behind: its map, and where it was last.
struct SavedMap {
  std::vector<Tile> tiles;
  std::vector<VoxelTile> voxels;
  std::int64_t instant_ns = 0;
  std::uint32_t odom_epoch = 0;
  Pose T_map_base = Pose::Identity();
  Vector6 twist_per_s = Vector6::Zero();
  /// of that odometry epoch; unknown: the next sweep is searched for around T_map_base
  std::optional<Pose> T_map_odom;
  /// the robot was found in it; where not, a map that is to be extended stays as it is until it is
  bool found = true;
};

/// The direction that the data fixes least. Vectors are unit in base_link, zero when none is weak.
struct Degeneracy {
  bool degenerate = false;
  Eigen::Vector3d weak_translation = Eigen::Vector3d::Zero();
  Eigen::Vector3d weak_rotation = Eigen::Vector3d::Zero();
  /// one sigma along the weakest direction: m when a translation is weak (or none), else rad
  double sigma_measured = 0.0;
  double sigma_predicted = 0.0;
  /// mean squared share of the normals along the weakest translation, 0..1
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
  /// tiles that left the window at this sweep, as they were; the mapper keeps them for the whole
  /// map
  std::vector<Tile> evicted;
  /// why the sweep was not inserted, empty when it was
  std::string reason;
  /// that ended with this sweep
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

  /// From the next sweep on. What the map was built with (its cubes, leaves and voxels) stays.
  void configure(const MappingConfig& config);

  /// Empties map and path; the next sweep initializes a new map at its predicted pose.
  void reset();

  /// Takes up what another instance left. Nothing is inserted before a sweep was matched against it
  /// (config.bridge_*); without points in it, the next sweep initializes a map in the same frame.
  void restore(const SavedMap& saved);
  /// The odometry may not have gone on where it was: the next sweep is searched for as after a new
  /// epoch, around where the odometry says.
  void expect_break();
  /// After restore(): a sweep that the instance before put into the map when that had been saved.
  /// state: of that instance after this sweep, or empty.
  void insert_again(const MappingInput& input, const Pose& T_map_odom,
                    std::span<const std::uint64_t> state);
  /// What it knows beside the map, for an instance of the same program that goes on from here; empty
  /// while that would not be all, as during a search.
  std::vector<std::uint64_t> state();
  /// After restore() and insert_again(): goes on from there as if it had been this instance. Taken
  /// up with the next sweep; what is no state of this program counts for nothing.
  void resume(std::span<const std::uint64_t> state);
  /// Somebody says that the next sweep is at this pose: it is searched for around it, also where it
  /// was thought to be found. Nothing is inserted before it is.
  void place(const Pose& T_map_base);
  /// The submap in the making, at the end of a run; none where too little was seen.
  std::optional<Submap> finish_submap();
  /// What the method has counted, of the cubes in which that has grown by more than this share
  /// since they were handed out (0: those that changed at all), ascending.
  std::vector<VoxelTile> take_changed_voxels(double growth);

  const Pose& T_map_odom() const;
  const std::vector<PathPose>& path() const;
  /// The points of one tile, also of one that left the window; empty when there is none.
  std::optional<Tile> tile(const TileId& id) const;
  /// All points ever counted in a tile at hand; 0: it is none.
  std::uint64_t tile_count(const TileId& id) const;
  /// All tiles that hold points, ascending (i, j, k, layer).
  std::vector<TileId> tiles() const;
  /// The local map around the last pose, in the order of cloud().
  std::vector<LayeredPoint> surround() const;
  /// The whole map in the order (tile, layer, insertion).
  std::vector<LayeredPoint> cloud() const;
  /// The part of cloud() that is of one tile.
  std::vector<LayeredPoint> tile_points(const TileId& id) const;
  std::size_t point_count() const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace zloam::mapping
