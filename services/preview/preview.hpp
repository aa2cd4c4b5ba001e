#pragma once
// What is sent of a map over a thin link, and in which order. No clock, messages or threads.
//
// The map's cubes are cut into blocks of some metres. A block is sent whole, as an octree whose
// cells are the larger the farther it is from the robot, and takes the place of what was sent of
// it before. One rule says what comes next: every other call goes round the map, what was sent
// longest ago first, so that who joins late has it all after one round; the calls between take
// what has changed, nearest first. What the one leaves of the budget the other takes, and what was
// sent some seconds ago waits. A block is sent with the largest cells first, so that a map shows
// soon.

#include <Eigen/Core>
#include <array>
#include <compare>
#include <cstddef>
#include <cstdint>
#include <map>
#include <optional>
#include <span>
#include <vector>

#include "preview/octree.hpp"

namespace zloam::preview {

/// Edge and plane points come apart, and are shown as one.
inline constexpr int kLayers = 2;
/// Beside its octree, of schemas/preview.fbs.
inline constexpr std::size_t kBlockHead_bytes = 16;

/// Which of two states of one cube and layer is the newer one.
struct Rank {
  std::uint32_t term = 0;
  std::uint64_t version = 0;
  auto operator<=>(const Rank&) const = default;
};

/// A block as it is sent: its cells have the edge block_m / 2^depth.
struct Piece {
  CubeIndex block;
  int depth = 1;
  std::vector<std::uint8_t> octree;

  std::size_t bytes() const { return kBlockHead_bytes + octree.size(); }
};

class Preview {
 public:
  /// One layer of a cube as it is now, instead of the one before. False: it was not taken, as it is
  /// older than that, no cube of a map, or one too many.
  bool put(const CubeIndex& cube, int layer, double edge_m, const Rank& rank,
           std::span<const MapPoint> points);

  /// What is sent next, together no larger than the budget.
  std::vector<Piece> take(std::size_t budget_bytes, const Eigen::Vector3d& robot_m);

  /// Another map.
  void clear();
  /// Nobody has got anything yet.
  void forget_sent();

  /// 0: no cube has come yet.
  double block_m() const { return block_m_; }
  /// Blocks in which something is.
  std::size_t blocks() const { return occupied_; }
  /// No cube more is taken.
  bool full() const;
  /// Calls of take() since the block was sent that was sent longest ago; nothing: one was never.
  std::optional<std::uint64_t> round() const;

 private:
  struct Block {
    /// of depth_ halvings of the block
    std::vector<Cell> cells;
    /// 0: never
    int sent_depth = 0;
    /// that was meant, though it may have been too much for a message
    int meant_depth = 0;
    std::uint64_t sent_at = 0;
    /// since then, seen with cells of that size
    bool changed = false;
  };
  struct Layer {
    Rank rank;
    std::vector<Cell> cells;
  };
  using Cube = std::array<std::optional<Layer>, kLayers>;
  struct Candidate {
    std::uint64_t sent_at;
    double distance_m;
    const CubeIndex* index;
    Block* block;
  };

  void begin(double edge_m);
  void cut(const CubeIndex& cube);
  void set(const CubeIndex& index, std::span<const Cell> cells);
  double distance_m(const CubeIndex& block, const Eigen::Vector3d& robot_m) const;
  int depth_at(double distance_m) const;
  int meant_depth(const Candidate& candidate) const;
  bool is_due(const Candidate& candidate) const;
  std::vector<Candidate> candidates(const Eigen::Vector3d& robot_m);
  void fill(std::vector<Candidate>& from, bool around, std::size_t budget_bytes,
            std::vector<Piece>& pieces);
  std::optional<Piece> piece(const Candidate& candidate, std::size_t room_bytes,
                             std::size_t budget_bytes) const;

  std::map<CubeIndex, Cube> cubes_;
  std::map<CubeIndex, Block> blocks_;
  std::size_t occupied_ = 0;
  double edge_m_ = 0.0, block_m_ = 0.0;
  /// halvings of a cube's edge to its blocks, and of a block's to its smallest cells
  int split_ = 0, depth_ = 0;
  std::uint64_t call_ = 0;
};

/// When a message may be sent: of any second no more than a share falls to each.
class Pace {
 public:
  explicit Pace(std::int64_t least_ns) : least_ns_(least_ns) {}
  /// Time of any monotonic clock. True: it counts as sent.
  bool may_send(std::int64_t now_ns);

 private:
  std::int64_t least_ns_;
  std::optional<std::int64_t> last_ns_;
};

}  // namespace zloam::preview
