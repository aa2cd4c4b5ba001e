#include "preview/preview.hpp"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <tuple>

#include "preview/config.hpp"

namespace zloam::preview {
namespace {

// After this many blocks that do not fit into the rest of the budget, no more are tried.
constexpr int kMisses = 16;
// Wider than the limits of mapping; cubes beyond are rejected as invalid.
constexpr double kLeastEdge_m = 1.0, kMostEdge_m = 1e4;
constexpr std::int32_t kMostIndex = 1 << 24;

bool is_cube(const CubeIndex& cube, double edge_m) {
  const auto near = [](std::int32_t index) { return index >= -kMostIndex && index < kMostIndex; };
  return edge_m >= kLeastEdge_m && edge_m <= kMostEdge_m && near(cube.i) && near(cube.j) &&
         near(cube.k);
}

}  // namespace

void Preview::clear() {
  cubes_.clear();
  blocks_.clear();
  occupied_ = 0;
  edge_m_ = block_m_ = 0.0;
}

void Preview::forget_sent() {
  for (auto& [index, block] : blocks_) block.sent_depth = 0;
  std::erase_if(blocks_, [](const auto& each) { return each.second.cells.empty(); });
}

/// The first cube determines the edge of all cubes of a map.
void Preview::begin(double edge_m) {
  clear();
  edge_m_ = edge_m;
  int depth = kSplit + 1;
  while (depth < kMostDepth && std::ldexp(edge_m, -(depth + 1)) >= kFinest_m) ++depth;
  split_ = kSplit;
  depth_ = depth - split_;
  block_m_ = std::ldexp(edge_m, -split_);
}

bool Preview::put(const CubeIndex& cube, int layer, double edge_m, const Rank& rank,
                  std::span<const MapPoint> points) {
  if (!is_cube(cube, edge_m) || layer < 0 || layer >= kLayers) return false;
  if (edge_m != edge_m_) begin(edge_m);
  if (full() && !cubes_.contains(cube)) return false;
  std::optional<Layer>& kept = cubes_[cube].at(static_cast<std::size_t>(layer));
  if (kept && rank <= kept->rank) return false;
  kept = Layer{rank, cells_of(points, cube, edge_m, split_ + depth_)};
  cut(cube);
  return true;
}

bool Preview::full() const { return std::max(blocks_.size(), cubes_.size()) >= kMostBlocks; }

/// Updates the blocks of a changed cube.
void Preview::cut(const CubeIndex& cube) {
  std::vector<Cell> cells;
  for (const std::optional<Layer>& layer : cubes_[cube]) {
    if (!layer) continue;
    std::vector<Cell> both;
    std::set_union(cells.begin(), cells.end(), layer->cells.begin(), layer->cells.end(),
                   std::back_inserter(both));
    cells = std::move(both);
  }
  const int shift = 3 * depth_;
  auto at = cells.begin();
  for (Cell block = 0; block < Cell{1} << 3 * split_; ++block) {
    const auto end = std::lower_bound(at, cells.end(), (block + 1) << shift);
    for (auto cell = at; cell != end; ++cell) *cell -= block << shift;
    set(below(cube, block, split_), {at, end});
    at = end;
  }
}

void Preview::set(const CubeIndex& index, std::span<const Cell> cells) {
  const auto found = blocks_.find(index);
  if (found == blocks_.end() && cells.empty()) return;
  Block& block = found == blocks_.end() ? blocks_[index] : found->second;
  if (block.sent_depth > 0 && !block.changed) {
    block.changed =
        coarser(cells, depth_, block.sent_depth) != coarser(block.cells, depth_, block.sent_depth);
  }
  occupied_ = occupied_ + (cells.empty() ? 0 : 1) - (block.cells.empty() ? 0 : 1);
  block.cells.assign(cells.begin(), cells.end());
  if (cells.empty() && block.sent_depth == 0) blocks_.erase(index);
}

double Preview::distance_m(const CubeIndex& block, const Eigen::Vector3d& robot_m) const {
  const Eigen::Array3d low = block_m_ * Eigen::Array3d(block.i, block.j, block.k);
  const Eigen::Array3d outside = (low - robot_m.array()).max(robot_m.array() - low - block_m_);
  return outside.max(0.0).matrix().norm();
}

int Preview::depth_at(double distance_m) const {
  int depth = depth_;
  double reach_m = kFineWithin_m;
  while (depth > std::max(1, depth_ - kDoublings) && distance_m > reach_m) {
    --depth;
    reach_m *= 2.0;
  }
  return depth;
}

int Preview::meant_depth(const Candidate& candidate) const {
  const bool first = candidate.block->sent_depth == 0;
  return first ? std::max(1, depth_ - kDoublings) : depth_at(candidate.distance_m);
}

bool Preview::is_due(const Candidate& candidate) const {
  const Block& block = *candidate.block;
  return block.sent_depth == 0 || block.changed ||
         block.meant_depth < depth_at(candidate.distance_m);
}

std::vector<Preview::Candidate> Preview::candidates(const Eigen::Vector3d& robot_m) {
  std::vector<Candidate> all;
  all.reserve(blocks_.size());
  for (auto& [index, block] : blocks_) {
    const std::uint64_t sent_at = block.sent_depth > 0 ? block.sent_at : 0;
    all.push_back({sent_at, distance_m(index, robot_m), &index, &block});
  }
  return all;
}

/// The block with the cells intended for its distance, or with larger ones if those exceed the
/// budget of a whole message; nothing if it only exceeds the room that is left.
std::optional<Piece> Preview::piece(const Candidate& candidate, std::size_t room_bytes,
                                    std::size_t budget_bytes) const {
  for (int depth = meant_depth(candidate); depth > 0; --depth) {
    const std::vector<Cell> cells = coarser(candidate.block->cells, depth_, depth);
    Piece piece{*candidate.index, depth, octree(cells, depth)};
    if (piece.bytes() <= room_bytes) return piece;
    if (piece.bytes() <= budget_bytes) break;
  }
  return std::nullopt;
}

void Preview::fill(std::vector<Candidate>& from, bool around, std::size_t budget_bytes,
                   std::vector<Piece>& pieces) {
  const auto later = [around](const Candidate& a, const Candidate& b) {
    const std::uint64_t a_at = around ? a.sent_at : 0, b_at = around ? b.sent_at : 0;
    return std::tie(a_at, a.distance_m, *a.index) > std::tie(b_at, b.distance_m, *b.index);
  };
  std::make_heap(from.begin(), from.end(), later);
  std::size_t room_bytes = budget_bytes;
  for (const Piece& piece : pieces) room_bytes -= piece.bytes();
  int misses = 0;
  while (!from.empty() && misses < kMisses && room_bytes > kBlockHead_bytes) {
    std::pop_heap(from.begin(), from.end(), later);
    const Candidate next = from.back();
    from.pop_back();
    Block& block = *next.block;
    if (block.sent_depth > 0 && block.sent_at == call_) continue;
    if (around && block.sent_depth > 0 && call_ - block.sent_at < kRestCalls) break;
    std::optional<Piece> made = piece(next, room_bytes, budget_bytes);
    if (!made) {
      ++misses;
      continue;
    }
    room_bytes -= made->bytes();
    block.meant_depth = meant_depth(next);
    block.sent_depth = made->depth;
    block.sent_at = call_;
    block.changed = false;
    pieces.push_back(std::move(*made));
  }
}

std::vector<Piece> Preview::take(std::size_t budget_bytes, const Eigen::Vector3d& robot_m) {
  ++call_;
  std::vector<Candidate> all = candidates(robot_m);
  std::vector<Candidate> due;
  std::copy_if(all.begin(), all.end(), std::back_inserter(due),
               [this](const Candidate& each) { return is_due(each); });
  std::vector<Piece> pieces;
  const bool around_first = call_ % 2 == 0;
  if (around_first) fill(all, true, budget_bytes, pieces);
  fill(due, false, budget_bytes, pieces);
  if (!around_first) fill(all, true, budget_bytes, pieces);
  return pieces;
}

std::optional<std::uint64_t> Preview::round() const {
  std::uint64_t longest = 0;
  for (const auto& [index, block] : blocks_) {
    if (block.sent_depth == 0) return std::nullopt;
    longest = std::max(longest, call_ - block.sent_at);
  }
  return longest;
}

bool Pace::may_send(std::int64_t now_ns) {
  if (last_ns_ && now_ns - *last_ns_ < least_ns_) return false;
  last_ns_ = now_ns;
  return true;
}

}  // namespace zloam::preview
