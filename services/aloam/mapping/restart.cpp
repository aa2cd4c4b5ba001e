// Restores a mapping that was killed and restarted: integration keeps its last corrections, the
// store its tiles and its last pose. Without a store, a new map begins: in the same frame, if
// integration has it.

#include <algorithm>
#include <optional>

#include "aloam/mapping/map_points.hpp"
#include "aloam/mapping/mapping_stage.hpp"
#include "aloam/mapping/taken_back.hpp"
#include "common/runtime/lost_map.hpp"
#include "common/runtime/recall.hpp"

namespace zloam::aloam {
namespace {

constexpr std::chrono::milliseconds kLinks{1000};
// The store's link may come up after the other links.
constexpr std::chrono::milliseconds kStoreLink{2000};
constexpr int kTries = 5;

/// The last mapped sweep of this run that another process knows.
struct LastMapped {
  std::uint64_t sweep = 0, map_id = 0;
  std::uint32_t odom_epoch = 0;
  Pose T_map_base = Pose::Identity(), T_map_odom = Pose::Identity();
};

/// From integration, which keeps the corrections.
std::optional<LastMapped> last_corrected(runtime::Stage& stage, std::uint64_t run) {
  const auto corrections =
      runtime::recall<msg::MapCorrection>(stage, Key::kMapCorrection, runtime::kKept, 1);
  const auto of_this_run = [&](const auto& c) { return c.run() == run; };
  const auto last = std::find_if(corrections.rbegin(), corrections.rend(), of_this_run);
  if (last == corrections.rend()) return std::nullopt;
  LastMapped found{last->sweep(), last->header().map_id(), last->header().odom_epoch()};
  found.T_map_odom = pose_of((*last)->pose_map_odom());
  const auto poses =
      runtime::recall<msg::MapPose>(stage, Key::kPose, runtime::sweeps_from(run, 0), 1);
  // T_map_base matters only for a new odom frame and for which cubes stay, so it may be missing.
  found.T_map_base = poses.empty() ? found.T_map_odom : pose_of(poses.back()->pose_map_base());
  return found;
}

/// From the store, which keeps the last mapped pose. Odometry has its own pose of that sweep, if it
/// is one of the last; if not, the odom frame counts as a new one.
std::optional<LastMapped> last_stored(runtime::Stage& stage, std::uint64_t run) {
  runtime::wait_for_links([&] { return runtime::is_there(stage, "store"); }, kStoreLink);
  const auto poses = runtime::recall_from<msg::MapPose>(stage, stage.keys().of(Key::kMapOdometry),
                                                        1, true, runtime::kStore);
  if (poses.empty() || poses.back().run() != run) return std::nullopt;
  const auto& last = poses.back();
  LastMapped found{last.sweep(), last.header().map_id(), ~last.header().odom_epoch()};
  found.T_map_base = pose_of(last->pose_map_base());
  const std::string of_sweep = runtime::sweeps_from(run, found.sweep, found.sweep);
  for (const auto& odometry : runtime::recall<msg::Odometry>(stage, Key::kOdometry, of_sweep, 1)) {
    if (odometry.header().odom_epoch() != last.header().odom_epoch()) continue;
    found.odom_epoch = last.header().odom_epoch();
    found.T_map_odom = normalised(found.T_map_base * pose_of(odometry->pose_odom_base()).inverse());
  }
  return found;
}

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

// No process has a pose of the earlier map, so the new one is in no frame of it.
void MappingStage::begin_unknown(const msg::Header& first) {
  map_id_ = runtime::EarlierIds().next(first.run(), first.sweep());
  stage_.degraded("map", runtime::lost_frame_text(first.sweep()));
}

void MappingStage::restart(const msg::Header& first) {
  if (first.sweep() > 0) {
    runtime::wait_for_links([this] { return correction_.matching(); }, kLinks);
  }
  std::optional<LastMapped> last = last_corrected(stage_, first.run());
  if (!last && runtime::may_follow_another(first.replay(), first.sweep(),
                                           stage_.shared().recovery.keep_messages)) {
    last = last_stored(stage_, first.run());
    if (!last) return begin_unknown(first);
  }
  if (!last) return;
  next_sweep_ = last->sweep + 1;
  map_id_ = last->map_id;
  odom_epoch_ = last->odom_epoch;
  mapper_.restore(last->T_map_base, last->T_map_odom);
  take_back_tiles(map_id_, last->T_map_base.translation());
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
