// Counts points. A sweep's points are sorted into the order of the octree first, so that each voxel
// is touched once per sweep: a voxel's sums are those of its children, shifted to its centre.

#include <algorithm>
#include <bit>

#include "common/containers/radix_sort.hpp"
#include "common/plane_map/voxel_plane_map.hpp"

namespace zloam::plane_map {
namespace {

// Entry n has the ten bits of n at every third position (Morton code).
constexpr std::array<std::uint32_t, 1024> kSpread = [] {
  std::array<std::uint32_t, 1024> table{};
  for (std::uint32_t n = 0; n < table.size(); ++n) {
    for (unsigned bit = 0; bit < 10; ++bit) table[n] |= (n >> bit & 1U) << (3 * bit);
  }
  return table;
}();

// Spreads a number of 21 bits in the same way.
std::uint64_t spread(std::uint32_t n) {
  const std::uint64_t high = kSpread[n >> 10U & 1023U] | std::uint64_t{n >> 20U & 1U} << 30U;
  return kSpread[n & 1023U] | high << 30U;
}

// Packs three signed numbers of 21 bits side by side, each with an offset that makes it positive.
std::uint64_t packed(Int4 cell) {
  const auto above = [](int n) { return static_cast<std::uint64_t>(std::int64_t{n} + (1 << 20)); };
  return above(cell[0]) | above(cell[1]) << 21U | above(cell[2]) << 42U;
}

std::uint32_t part(std::uint64_t packed, unsigned axis) {
  return static_cast<std::uint32_t>(packed >> (21U * axis)) & 0x1fffffU;
}

}  // namespace

void VoxelPlaneMap::Gathered::add(const Gathered& other, const Offset& offset) {
  rings.add(other.rings);
  count += other.count;
  sums.add(other.sums, other.count, offset);
}

void VoxelPlaneMap::Counted::add(const Gathered& gathered) {
  Rings all = rings();
  all.add(gathered.rings);
  ring = all.ring;
  lead = all.lead;
  count += gathered.count;
}

// Sorts the points into placed_, in the octree's order, without those outside the range of cells.
void VoxelPlaneMap::place(std::span<const LocalPoint> points) {
  placed_.clear();
  Int4 low{}, high{};
  for (std::size_t i = 0; i < points.size(); ++i) {
    const Float4 point = points[i].lanes();
    if (!has_cell(point)) continue;
    const Int4 cell = cell_lanes(point);
    if (placed_.empty()) low = high = cell;
    low = least_of(low, cell);
    high = most_of(high, cell);
    placed_.push_back({packed(cell), static_cast<std::uint32_t>(i)});
  }
  low = low >> shift_ << shift_;
  const std::uint64_t lowest = packed(low);
  for (Placed& p : placed_) {
    const std::uint64_t from_low = p.code - lowest;  // no part is below its lowest
    p.code = spread(part(from_low, 0)) | spread(part(from_low, 1)) << 1U |
             spread(part(from_low, 2)) << 2U;
  }
  const Int4 wide = high - low;
  const int widest = std::max({wide[0], wide[1], wide[2]});
  const int bits = 3 * std::bit_width(static_cast<std::uint32_t>(widest));
  radix_sort(placed_, placed_spare_, bits, [](const Placed& p) { return p.code; });
}

// The first points that lie in the same voxel. bit: the voxel's level, as the index of the group of
// three bits in the code that is its octant within its parent.
std::span<const VoxelPlaneMap::Placed> VoxelPlaneMap::together(std::span<const Placed> placed,
                                                               int bit) {
  const auto voxel = [bit](const Placed& p) { return p.code >> (3 * bit); };
  std::size_t count = 1;
  while (count < placed.size() && voxel(placed[count]) == voxel(placed[0])) ++count;
  return placed.first(count);
}

unsigned VoxelPlaneMap::octant_of(const Placed& placed, int bit) {
  return static_cast<unsigned>(placed.code >> (3 * bit)) & 7U;
}

VoxelPlaneMap::Gathered VoxelPlaneMap::gather(std::span<const LocalPoint> points,
                                              std::span<const Placed> placed,
                                              const Offset& centre) {
  Gathered out;
  for (const Placed& p : placed) {
    const LocalPoint& point = points[p.point];
    out.rings.add({point.ring, point.ring == kUnknownRing ? 0U : 1U});
    out.sums.add(point.x - centre[0], point.y - centre[1], point.z - centre[2]);
  }
  out.count = static_cast<std::uint32_t>(placed.size());
  return out;
}

VoxelPlaneMap::Gathered VoxelPlaneMap::count_in_leaf(std::uint32_t index,
                                                     std::span<const LocalPoint> points,
                                                     std::span<const Placed> placed,
                                                     const Offset& centre) {
  const Gathered gathered = gather(points, placed, centre);
  Leaf& leaf = leaves_[index];
  if (!leaf.is_full()) {
    leaf.add(gathered);
    leaf.sums.add(gathered.sums);
  }
  return gathered;
}

VoxelPlaneMap::Gathered VoxelPlaneMap::count_in_node(std::uint32_t index, int level,
                                                     std::span<const LocalPoint> points,
                                                     std::span<const Placed> placed,
                                                     const Offset& centre) {
  Node& node = nodes_[index];
  const Gathered gathered = node.kind == Kind::kSettledPlane
                                ? gather(points, placed, centre)
                                : count_in_children(node, level, points, placed, centre);
  if (!node.is_full()) {
    node.add(gathered);
    node.sums.add(gathered.sums);
  }
  if (node.kind == Kind::kPlane && node.count >= config_.settled_points) {
    settle(node, level);
  }
  return gathered;
}

VoxelPlaneMap::Gathered VoxelPlaneMap::count_in_children(Node& node, int level,
                                                         std::span<const LocalPoint> points,
                                                         std::span<const Placed> placed,
                                                         const Offset& centre) {
  const int bit = shift_ - 1 - level;
  std::array<std::span<const Placed>, 8> parts;
  const std::size_t count = take_children(node, bit, placed, parts);
  const float quarter = 0.25f * static_cast<float>(config_.root_voxel_m / (1 << level));
  Gathered all;
  for (const std::span<const Placed> part : std::span(parts).first(count)) {
    const unsigned octant = octant_of(part.front(), bit);
    const Offset offset = {(octant & 1U) != 0 ? quarter : -quarter,
                           (octant & 2U) != 0 ? quarter : -quarter,
                           (octant & 4U) != 0 ? quarter : -quarter};
    const Offset at = {centre[0] + offset[0], centre[1] + offset[1], centre[2] + offset[2]};
    const std::uint32_t child = node.children[octant];
    all.add(bit == 0 ? count_in_leaf(child, points, part, at)
                     : count_in_node(child, level + 1, points, part, at),
            offset);
  }
  return all;
}

// Splits the points by child, and creates or prefetches the children: most of a sweep's time is
// spent waiting for memory.
std::size_t VoxelPlaneMap::take_children(Node& node, int bit, std::span<const Placed> placed,
                                         std::array<std::span<const Placed>, 8>& parts) {
  std::size_t count = 0;
  while (!placed.empty()) {
    parts[count] = together(placed, bit);
    std::uint32_t& child = node.children[octant_of(placed.front(), bit)];
    if (child == kNoChild) {
      child = bit == 0 ? leaves_.take() : nodes_.take();
    } else if (bit == 0) {
      leaves_.fetch(child);
    } else {
      nodes_.fetch(child);
    }
    placed = placed.subspan(parts[count++].size());
  }
  return count;
}

// Fills roots_hit_ in the octree's order; take: creates missing roots.
void VoxelPlaneMap::hit_roots(std::span<const LocalPoint> points, bool take) {
  place(points);
  roots_hit_.clear();
  for (std::span<const Placed> placed = placed_; !placed.empty();) {
    const std::span<const Placed> part = together(placed, shift_);
    const Cell cell = cell_of(points[part.front().point]);
    const std::uint64_t key = root_key(cell);
    roots_hit_.push_back({take ? take_root(key) : find_root(key), cell, part});
    placed = placed.subspan(part.size());
  }
}

void VoxelPlaneMap::insert(std::span<const LocalPoint> points) {
  hit_roots(points, true);
  for (std::size_t i = 0; i < roots_hit_.size(); ++i) {
    fetch_root(i + kAhead);
    const RootHit& hit = roots_hit_[i];
    count_in_node(hit.node, 0, points, hit.points, root_centre(hit.cell));
  }
}

void VoxelPlaneMap::insert_points(std::span<const Eigen::Vector3d> points_map) {
  for (const Eigen::Vector3d& point : points_map) {
    const Eigen::Vector3d grid = T_grid_map_ * point;
    if (!grid.allFinite()) continue;
    set_anchor(grid);
    const Eigen::Vector3f local = (grid - anchor_grid()).cast<float>();
    const LocalPoint one{local.x(), local.y(), local.z(), kUnknownRing};
    insert(std::span(&one, 1));
  }
}

}  // namespace zloam::plane_map
