// Restores a mapping that was killed and restarted: integration keeps its last corrections, the
// store its tiles. Without a store, a new map begins in the same frame.

#include <algorithm>

#include "aloam/mapping/map_points.hpp"
#include "aloam/mapping/mapping_stage.hpp"
#include "aloam/mapping/taken_back.hpp"
#include "common/runtime/lost_map.hpp"
#include "common/runtime/recall.hpp"

namespace zloam::aloam {
namespace {

constexpr std::chrono::milliseconds kLinks{1000};
constexpr int kTries = 5;

}  // namespace

void MappingStage::take_back_tiles(std::uint64_t map_id, const Eigen::Vector3d& sensor) {
  TakenBack taken;
  for (const auto& tile :
       runtime::recall_at<msg::MapTile>(stage_, stage_.keys().all_tiles(), kTries, false)) {
    const auto layer = layer_from_name(tile->layer()->str());
    if (!layer || tile.header().map_id() != map_id || tile->edge_m() != kCube_m) continue;
    taken.add({{tile->i(), tile->j(), tile->k()}}, *layer, {tile.header().term(), tile->version()},
              cloud_of(map_points_of(tile->points())));
  }
  mapper_.map().restore(taken.take(), sensor);
}

void MappingStage::restart(const msg::Header& first) {
  if (first.sweep() > 0) {
    runtime::wait_for_links([this] { return correction_.matching(); }, kLinks);
  }
  const auto corrections =
      runtime::recall<msg::MapCorrection>(stage_, Key::kMapCorrection, runtime::kKept, 1);
  const auto of_this_run = [&](const auto& c) { return c.run() == first.run(); };
  const auto last = std::find_if(corrections.rbegin(), corrections.rend(), of_this_run);
  if (last == corrections.rend()) return;
  next_sweep_ = last->sweep() + 1;
  map_id_ = last->header().map_id();
  odom_epoch_ = last->header().odom_epoch();
  const Pose T_map_odom = pose_of((*last)->pose_map_odom());
  const auto poses =
      runtime::recall<msg::MapPose>(stage_, Key::kPose, runtime::sweeps_from(first.run(), 0), 1);
  // T_map_base matters only for a new odom frame and for which cubes stay, so it may be missing.
  const Pose T_map_base = poses.empty() ? T_map_odom : pose_of(poses.back()->pose_map_base());
  mapper_.restore(T_map_base, T_map_odom);
  take_back_tiles(map_id_, T_map_base.translation());
  const std::size_t points = mapper_.map().point_count();
  if (points == 0) {
    // As after a reset, so that no reader shows tiles of the lost map in the new one.
    ++map_id_;
    stage_.degraded("map", runtime::lost_map_text(first.sweep()));
  }
  file_.changed(points > 0);
  if (first.replay()) ack_.done_below(first.run(), next_sweep_);
  runtime::log_warning("resuming the map of the previous instance", {{"points", points}});
}

}  // namespace zloam::aloam
