#pragma once
// A map of planes in voxels of several sizes. Each point is counted in the voxel of every level
// that contains it (number, sum, sum of outer products), so nothing old is forgotten and the
// normal's error falls with the root of the count; planes are eigenvectors of these sums, computed
// when a changed voxel is looked up. Method: Yuan et al., "Efficient and probabilistic adaptive
// voxel mapping", RA-L 2022, with counted sums instead of stored points.
//
// The map's frame is the caller's. Inside, voxels live in a "grid" frame rotated and shifted
// against it (config). Look-up and insertion take "local" single-precision coordinates: grid frame,
// relative to an anchor on the grid near the sensor, so that no digits are lost far from the
// origin.
//
// Result and content depend on the order of calls only, never on addresses or hashing.

#include <Eigen/Core>
#include <array>
#include <cmath>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "common/containers/pool.hpp"
#include "common/geometry/lanes.hpp"
#include "common/geometry/se3.hpp"
#include "common/plane_map/config.hpp"
#include "common/plane_map/moments.hpp"
#include "common/plane_map/saved_voxel.hpp"

namespace zloam::plane_map {

/// Residual of a point p: nx px + ny py + nz pz - d, with p relative to the root voxel's centre.
struct PlaneRow {
  float nx = 0, ny = 0, nz = 0, d = 0;

  Float4 lanes() const { return Float4{nx, ny, nz, d}; }
};

/// What a look-up found: one row of a plane (unit normal, residual in m), or two or three rows of a
/// distribution (residuals in noise sigmas, times the range noise to be in m).
struct Match {
  const PlaneRow* rows = nullptr;
  int count = 0;
  bool is_plane = false;
  float normal_variance = 0;  // rad^2, planes only
  /// Set by find_all(): number of its points on surfaces facing this way in this root voxel.
  float crowd = 0;
  Float4 root_centre{};  // local coordinates, and 1: the factor of a row's -d
};

constexpr std::uint16_t kUnknownRing = 0xffff;

/// A point to be counted. The ring only tells whether a voxel holds several rings.
struct LocalPoint {
  float x = 0, y = 0, z = 0;
  std::uint16_t ring = kUnknownRing;

  Float4 lanes() const { return Float4{x, y, z, 0.0f}; }
};

/// A plane in the map's frame.
struct MapPlane {
  Eigen::Vector3d normal;
  Eigen::Vector3d centre;
};

struct MapStatistics {
  std::size_t roots = 0;
  std::size_t voxels = 0;
  std::size_t bytes = 0;
};

class VoxelPlaneMap {
 public:
  /// Throws std::invalid_argument for a configuration outside the ranges that its fields state.
  explicit VoxelPlaneMap(const PlaneMapConfig& config);

  const PlaneMapConfig& config() const { return config_; }
  const Pose& T_grid_map() const { return T_grid_map_; }
  bool empty() const { return roots_.empty(); }

  /// Puts the anchor of local coordinates on the grid corner nearest to a position (grid frame).
  void set_anchor(const Eigen::Vector3d& position_grid);
  Eigen::Vector3d anchor_grid() const;

  /// Finest voxels from the anchor.
  struct Cell {
    int x, y, z;
    bool operator==(const Cell&) const = default;
  };
  /// Last result of find() for a point that moves little between two calls. Valid until the next
  /// insertion or change of the anchor.
  struct Hint {
    Float4 cell_centre = all_lanes(kNowhere);  // finest voxels from the anchor, and 0
    Match match;
  };

  /// Coarse to fine, the first plane wins; no result: count == 0. Local coordinates. Fits voxels
  /// that have changed, so it is not const. Rows stay valid until the next insertion.
  Match find(float x, float y, float z);
  /// The same for (x, y, z, 0), looked up only when the point has left the hint's cell; the crowd
  /// stays that of the cell where it was found first.
  const Match& find(Float4 point, Hint& hint) {
    if (!all_below(point * leaf_per_m_ - hint.cell_centre, 0.5f)) look_up(point, hint);
    return hint.match;
  }

  /// The same for many points, in an order that suits the memory. hints: as many as points; their
  /// previous content is ignored.
  void find_all(std::span<const LocalPoint> points, std::span<Hint> hints);

  /// Counts points, local coordinates. Those that are not finite or farther than 3 km from the
  /// anchor are ignored.
  void insert(std::span<const LocalPoint> points);

  /// The same in the map's frame, for callers outside the inner loops.
  std::optional<MapPlane> plane_at(const Eigen::Vector3d& point_map);
  void insert_points(std::span<const Eigen::Vector3d> points_map);

  /// Drops voxels farther than keep_radius_m from the position (grid frame), and voxels finer than
  /// the planes that fell behind settled_radius_m; does nothing until the position has moved by a
  /// twentieth of keep_radius_m since the last time.
  void leave_behind(const Eigen::Vector3d& position_grid);

  MapStatistics statistics() const;

  /// roots(): the coarsest voxels in order of creation; save_root(): all counts in one of them.
  std::vector<RootSummary> roots() const;
  Eigen::Vector3d root_centre_map(const std::array<std::int32_t, 3>& index) const;
  void save_root(std::size_t place, std::vector<SavedVoxel>& out) const;
  /// Restores the result of save_root(), voxel by voxel in its order, into a map of the same voxel
  /// sizes and grid. False: the voxel is invalid.
  bool load(const SavedVoxel& voxel);

 private:
  static constexpr std::uint32_t kNoChild = 0xffffffffu;
  static constexpr float kMaxLocal_m = 3000.0f;  // 2^21 of the smallest voxels apart
  static constexpr float kNowhere = 1e9f;
  // The memory of a root is prefetched this many roots ahead.
  static constexpr std::size_t kAhead = 4;

  // Content of a voxel. A settled plane creates no finer voxels.
  enum class Kind : std::uint8_t { kNone, kPlane, kSettledPlane, kLine, kBlob };

  struct Plane {
    PlaneRow row;
    float normal_variance = 0;
  };

  // The ring of the points, by majority vote (Boyer and Moore 1981, joined as in Misra and Gries):
  // a ring with more than half of n points is `ring`, and has between `lead` and (n + lead) / 2 of
  // them. lead == n: there is no other.
  struct Rings {
    std::uint16_t ring = kUnknownRing;
    std::uint32_t lead = 0;

    void add(const Rings& other);
  };

  using Offset = std::array<float, 3>;

  // The part of an insertion that falls into one voxel, relative to its centre.
  struct Gathered {
    std::uint32_t count = 0;
    MomentSums<double> sums;
    Rings rings;

    /// Adds a part of the voxel whose centre lies at `offset`.
    void add(const Gathered& other, const Offset& offset);
  };

  // A point's place in the order of the octree: three bits per level, the root's at the top.
  struct Placed {
    std::uint64_t code;
    std::uint32_t point;
  };
  struct RootHit {
    std::uint32_t node;  // kNoChild: there is none
    Cell cell;           // of the first point
    std::span<const Placed> points;
  };

  // Fits are stored separately: most voxels hold nothing but counts, which fill the map's memory.
  // Sums are in single precision: offsets are below the voxel's edge, and added once per sweep. A
  // voxel with so many points takes no more: a sensor that stands for days would add sweeps of less
  // than the sums can tell, which bends the planes, and more points than the count can hold.
  static constexpr std::uint32_t kMostCounted = 1U << 23;
  struct Counted {
    std::uint32_t count = 0;
    std::uint32_t refit_at = 0;  // count from which it is fitted again
    std::uint32_t fit = 0;       // place in planes_ or, of lines and blobs, in rows_
    std::uint32_t lead = 0;      // of `ring`
    std::uint16_t ring = kUnknownRing;
    Kind kind = Kind::kNone;

    bool is_full() const { return count >= kMostCounted; }
    void add(const Gathered& gathered);
    Rings rings() const { return {ring, lead}; }
    bool several_rings() const { return lead < count; }
    bool is_plane() const { return kind == Kind::kPlane || kind == Kind::kSettledPlane; }
    bool is_distribution() const { return kind == Kind::kLine || kind == Kind::kBlob; }
  };

  struct Node : Counted {
    std::array<std::uint32_t, 8> children;
    MomentSums<float> sums;
    Node() { children.fill(kNoChild); }
  };

  struct Leaf : Counted {
    MomentSums<float> sums;
  };

  struct Root {
    std::uint64_t key;
    std::uint32_t node;
  };

  /// Index of a voxel's child that contains a cell; bit: the bit of the cell's indices that selects
  /// the child.
  static unsigned octant(const Cell& c, int bit) {
    return static_cast<unsigned>((c.x >> bit & 1) | (c.y >> bit & 1) << 1 | (c.z >> bit & 1) << 2);
  }
  /// Whether the point lies within the range of cells; false for NaN.
  static bool has_cell(Float4 point) { return all_below(point, kMaxLocal_m); }
  Int4 cell_lanes(Float4 point) const { return floor_to_int(point * leaf_per_m_); }
  static Cell cell_of(Int4 lanes) { return {lanes[0], lanes[1], lanes[2]}; }
  Cell cell_of(const LocalPoint& point) const { return cell_of(cell_lanes(point.lanes())); }
  std::uint64_t root_key(const Cell& cell) const;
  std::uint32_t find_root(std::uint64_t key) const;
  std::uint32_t take_root(std::uint64_t key);
  void rebuild_table(std::size_t slots);
  void place(std::span<const LocalPoint> points);
  void hit_roots(std::span<const LocalPoint> points, bool take);
  static std::span<const Placed> together(std::span<const Placed> placed, int bit);
  static Gathered gather(std::span<const LocalPoint> points, std::span<const Placed> placed,
                         const Offset& centre);
  Gathered count_in_leaf(std::uint32_t index, std::span<const LocalPoint> points,
                         std::span<const Placed> placed, const Offset& centre);
  Gathered count_in_node(std::uint32_t index, int level, std::span<const LocalPoint> points,
                         std::span<const Placed> placed, const Offset& centre);
  static unsigned octant_of(const Placed& placed, int bit);
  std::size_t take_children(Node& node, int bit, std::span<const Placed> placed,
                            std::array<std::span<const Placed>, 8>& parts);
  Gathered count_in_children(Node& node, int level, std::span<const LocalPoint> points,
                             std::span<const Placed> placed, const Offset& centre);
  Match look_up(const Cell& cell);
  void look_up(Float4 point, Hint& hint);
  /// In finest voxels, and 0.
  static Float4 centre_of(Int4 cell) {
    constexpr Float4 kHalf{0.5f, 0.5f, 0.5f, 0.0f};
    return __builtin_convertvector(cell, Float4) + kHalf;
  }
  // Points that a look-up has led to the same finest voxel, or to none. match: from a coarser
  // voxel, a plane, which ends the search, or a post, for a finest voxel without a fit of its own.
  struct Found {
    std::span<const Placed> points;
    std::uint32_t leaf = kNoChild;
    Match match;
  };
  Float4 root_lanes(const Cell& cell) const;
  Node& fitted_node(std::uint32_t index, const Cell& cell, int level);
  Match match_of_leaf(std::uint32_t index, const Cell& cell, Float4 root, const Match& post);
  void find_in_root(const RootHit& hit, std::span<const LocalPoint> points);
  void find_in_node(std::uint32_t index, int level, std::span<const Placed> placed,
                    std::span<const LocalPoint> points, Float4 root, const Match& post);
  void count_crowds();
  void fetch_root(std::size_t hit) const;
  std::array<const Node*, 8> parents_around(const Cell& cell) const;
  std::array<float, 3> root_centre(const Cell& cell) const;
  Eigen::Vector3d voxel_offset(const Cell& cell, int level) const;
  std::uint32_t next_fit(std::uint32_t count) const;
  void fit_node(Node& node, const Cell& cell, int level);
  void fit_leaf(Leaf& leaf, const Cell& cell);
  struct Neighbour {
    std::uint32_t leaf;
    Eigen::Vector3i step;  // in finest voxels
  };
  std::size_t neighbours_of(const Cell& cell, std::array<Neighbour, 26>& found) const;
  Moments merged_moments(const Leaf& leaf, const Cell& cell, Rings& rings) const;
  bool enough(const Rings& rings, double count) const;
  bool is_trace(const PrincipalAxes& axes, const Rings& rings, double count) const;
  bool is_post(const PrincipalAxes& axes, const Node& node, int level) const;
  void set_distribution(Counted& voxel, Kind kind, const PrincipalAxes& axes,
                        const Eigen::Vector3d& offset);
  void fit_distribution(Leaf& leaf, const PrincipalAxes& axes, const Eigen::Vector3d& offset);
  void set_plane(Counted& voxel, const PrincipalAxes& axes, double count,
                 const Eigen::Vector3d& offset);
  void set_kind(Counted& voxel, Kind kind);
  Match match_of(const Counted& voxel, Float4 root) const;
  void release_children(Node& node, int level);
  void release_node(std::uint32_t node, int level);
  void settle(Node& node, int level);
  void settle_far_planes(Node& node, int level);
  void settle_behind(const Eigen::Vector3d& from_grid, const Eigen::Vector3d& to_grid);
  void drop_far(const Eigen::Vector3d& position_grid);
  Eigen::Vector3d root_centre_grid(const std::array<std::int32_t, 3>& index) const;
  void save_node(const Node& node, SavedVoxel at, std::vector<SavedVoxel>& out) const;

  PlaneMapConfig config_;
  PlaneGates own_gates_;
  PlaneGates merged_gates_;
  Pose T_grid_map_;
  int shift_;  // finest voxels per root edge = 1 << shift_
  float leaf_per_m_;
  double leaf_m_;
  Eigen::Vector3i anchor_ = Eigen::Vector3i::Zero();  // in roots
  std::optional<Eigen::Vector3d> left_behind_from_grid_;

  std::vector<Root> roots_;           // in order of creation
  std::vector<std::uint32_t> table_;  // open addressing: index into roots_ + 1, 0 = free
  Pool<Node> nodes_;
  Pool<Leaf> leaves_;
  Pool<Plane> planes_;
  Pool<std::array<PlaneRow, 3>> rows_;
  std::vector<Placed> placed_, placed_spare_;  // of the present insertion
  std::vector<RootHit> roots_hit_;
  std::vector<Found> found_;  // of the root whose points are looked up
};

}  // namespace zloam::plane_map
