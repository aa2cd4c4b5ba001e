#include "preview/preview_stage.hpp"

#include <chrono>
#include <string_view>
#include <vector>

#include "common/runtime/log.hpp"
#include "common/runtime/read.hpp"
#include "preview/config.hpp"

namespace zloam::preview {
namespace {

using std::chrono::milliseconds;

constexpr std::size_t kNewestTiles = 4096;
// Padding within the message for the alignment of the vectors.
constexpr std::size_t kPadding_bytes = 32;

/// Nothing for the voxel layer, which is not for viewing.
std::optional<int> layer_of(std::string_view name) {
  if (name == "edge") return 0;
  if (name == "plane") return 1;
  return std::nullopt;
}

}  // namespace

PreviewStage::PreviewStage(runtime::Stage& stage)
    : stage_(stage),
      out_(stage.outlet(Key::kPreview)),
      tiles_(stage.session(), stage.keys().all_tiles(), kNewestTiles),
      all_tiles_(stage, "the preview"),
      pace_(kLeastPeriod_ns) {
  runtime::InletOptions options;
  options.order = runtime::Order::kAsTheyCome;
  options.lossless = true;
  stage.inlet<msg::MapPose>(Key::kPose, options, [this](const PoseMessage& m) { take(m); });
  options.ends_run = false;
  stage.inlet<msg::MapPose>(Key::kMapOdometry, options,
                            [this](const PoseMessage& m) { take_mapped(m); });
  // Tiles may be dropped on the way, so all are requested again at the end of a run.
  stage.on_end_of_run([this](std::uint64_t) { all_tiles_.want(); });
  stage.every(milliseconds(kPeriod_ms), [this] { every_period(); });
}

void PreviewStage::take(const PoseMessage& m) {
  Newest newest;
  newest.header = header_fields(m.header());
  newest.received_ns = m.raw().received_ns;
  newest.fields.instant_ns = m->instant_ns();
  newest.fields.T_map_base = pose_of(m->pose_map_base());
  newest.fields.health = health_of(m->health());
  newest.fields.degenerate = m->degenerate();
  newest_ = std::move(newest);
}

void PreviewStage::take_mapped(const PoseMessage& m) {
  const std::uint64_t map_id = m.header().map_id();
  // At the first sweep of the run that began the map, the map starts anew: a replay of the same
  // capture has the same map_id.
  const bool again = m.sweep() == 0 && map_id == m.run();
  if (map_id_ != map_id || again) begin_map(map_id);
}

/// All tiles are requested again, as some of this map may have arrived, and been dropped, before it
/// was known to be the current one.
void PreviewStage::begin_map(std::uint64_t map_id) {
  map_id_ = map_id;
  ++epoch_;
  preview_.clear();
  all_tiles_.want();
}

void PreviewStage::take_tile(const zenoh::Sample& sample) {
  const runtime::Read<msg::MapTile> tile(Key::kMapTile, sample);
  if (!tile) return;
  const auto layer = layer_of(tile->layer()->string_view());
  if (!layer) return;
  const msg::Header& header = *tile->header();
  // Without a current run no pose names the map, so the first tile does.
  if (!map_id_) map_id_ = header.map_id();
  if (map_id_ != header.map_id()) return;
  preview_.put({tile->i(), tile->j(), tile->k()}, *layer, tile->edge_m(),
               {header.term(), tile->version()}, map_points_of(tile->points()));
}

void PreviewStage::take_tiles() {
  for (const zenoh::Sample& sample : all_tiles_.take()) take_tile(sample);
  for (const zenoh::Sample& sample : tiles_.take()) take_tile(sample);
  stage_.degraded("map", preview_.full() ? "the preview shows " + std::to_string(kMostBlocks) +
                                               " blocks of the map; there are more"
                                         : std::string());
}

// Without a subscriber, no tiles are requested and nothing is computed.
void PreviewStage::every_period() {
  const bool wanted = out_.matching();
  if (tiles_.want(wanted)) {
    preview_.forget_sent();
    all_tiles_.want();
  }
  stage_.figure("has_reader", wanted ? 1.0 : 0.0);
  // It asks again when somebody reads it again.
  if (!wanted) return all_tiles_.no_reader();
  all_tiles_.ask(preview_.blocks() == 0);
  take_tiles();
  if (pace_.may_send(runtime::steady_ns())) say();
}

HeaderFields PreviewStage::header() const {
  const std::int64_t now_ns = stage_.now_ns();
  HeaderFields made = out_.header(newest_ ? newest_->received_ns : now_ns, now_ns);
  if (newest_) {
    const HeaderFields& cause = newest_->header;
    made.sensor = cause.sensor;
    made.run = cause.run;
    made.sweep = cause.sweep;
    made.stamp_ns = cause.stamp_ns;
    made.odom_epoch = cause.odom_epoch;
    made.last_packet_ns = cause.last_packet_ns;
    made.replay = cause.replay;
    made.trace.insert(made.trace.begin(), cause.trace.begin(), cause.trace.end());
  }
  made.frame = "map";
  made.map_id = map_id_.value_or(0);
  return made;
}

void PreviewStage::say() {
  const HeaderFields made = header();
  PreviewFields fields = newest_ ? newest_->fields : PreviewFields{};
  fields.epoch = epoch_;
  fields.block_m = preview_.block_m();
  fields.map_blocks = static_cast<std::uint32_t>(preview_.blocks());
  const std::size_t head_bytes = build(made, fields).size() + kPadding_bytes;
  if (head_bytes > kMessage_bytes) return;
  const Eigen::Vector3d robot_m = fields.T_map_base
                                      ? Eigen::Vector3d(fields.T_map_base->translation())
                                      : Eigen::Vector3d::Zero();
  std::vector<msg::PreviewBlock> blocks;
  std::vector<std::uint8_t> octrees;
  for (const Piece& piece : preview_.take(kMessage_bytes - head_bytes, robot_m)) {
    blocks.emplace_back(piece.block.i, piece.block.j, piece.block.k,
                        static_cast<std::uint16_t>(piece.octree.size()),
                        static_cast<std::uint8_t>(piece.depth), std::uint8_t{0});
    octrees.insert(octrees.end(), piece.octree.begin(), piece.octree.end());
  }
  fields.blocks = blocks;
  fields.octrees = octrees;
  Buffer message = build(made, fields);
  note_figures(message.size());
  out_.publish(made, std::move(message));
}

void PreviewStage::note_figures(std::size_t bytes) {
  stage_.figure("blocks", static_cast<double>(preview_.blocks()));
  stage_.figure("message_bytes", static_cast<double>(bytes));
  // Time until a new subscriber has the whole map.
  if (const auto round = preview_.round()) {
    stage_.figure("round_s", 1e-3 * static_cast<double>(*round * kPeriod_ms));
  }
}

}  // namespace zloam::preview
