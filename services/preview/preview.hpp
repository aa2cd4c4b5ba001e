#pragma once
// Selects what to send of a map over a thin link, and its order. No clock, messages or threads.
//
// The map's cubes are cut into blocks of some metres. A block is sent whole, as an octree with
// larger cells farther from the robot, and replaces what was sent of it before. Every other
// call goes round the map, with the block sent longest ago first, so that a late subscriber
// has the whole map after one round. The calls between send the blocks that have changed,
// nearest first. Either kind of call gives the rest of its budget to the other; a block sent
// some seconds ago waits. A block is first sent with the largest cells, so that a map shows
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

/// Edge points and plane points arrive in separate messages and are shown as one.
inline constexpr int kLayers = 2;
/// Bytes of a block in schemas/preview.fbs beside its octree.
inline constexpr std::size_t kBlockHead_bytes = 16;

/// Orders two states of one cube and layer by age.
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
  /// Replaces one layer of a cube. False if it was rejected: it is older than the layer kept, is no
  /// valid cube of a map, or exceeds the number of cubes.
  bool put(const CubeIndex& cube, int layer, double edge_m, const Rank& rank,
           std::span<const MapPoint> points);

  /// The blocks to send next, together no larger than the budget.
  std::vector<Piece> take(std::size_t budget_bytes, const Eigen::Vector3d& robot_m);

  /// Starts another map.
  void clear();
  /// Treats every block as not sent yet.
  void forget_sent();

  /// 0: no cube has been put yet.
  double block_m() const { return block_m_; }
  /// Number of blocks that are not empty.
  std::size_t blocks() const { return occupied_; }
  /// No further cube is accepted.
  bool full() const;
  /// Calls of take() since the oldest sending of a block; nothing: a block was never sent.
  std::optional<std::uint64_t> round() const;

 private:
  struct Block {
    /// of depth_ halvings of the block
    std::vector<Cell> cells;
    /// 0: never
    int sent_depth = 0;
    /// the depth intended, even where that was too much for a message
    int meant_depth = 0;
    std::uint64_t sent_at = 0;
    /// since it was sent, as seen with cells of the depth sent
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

/// Limits when messages may be sent: two are at least least_ns apart.
class Pace {
 public:
  explicit Pace(std::int64_t least_ns) : least_ns_(least_ns) {}
  /// now_ns: time of any monotonic clock. True: the message counts as sent.
  bool may_send(std::int64_t now_ns);

 private:
  std::int64_t least_ns_;
  std::optional<std::int64_t> last_ns_;
};

}  // namespace zloam::preview
