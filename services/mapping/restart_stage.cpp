// Restart of mapping after a kill (docs/protocol.md, section 7): the store has its map and its last
// pose, integration its last corrections.

#include <algorithm>
#include <map>
#include <span>
#include <sstream>
#include <string>
#include <tuple>
#include <utility>

#include "common/runtime/lost_map.hpp"
#include "common/runtime/recall.hpp"
#include "common/runtime/shared.hpp"
#include "mapping/io/tile_messages.hpp"
#include "mapping/mapping_stage.hpp"
#include "mapping/voxel_tiles.hpp"

namespace zloam::mapping {
namespace {

// The store's link may come up after the other links: the store connects to mapping within a
// second.
constexpr double kStoreLink_s = 2.0;
// Wait for the other links; live no longer than the queue can hold the sweeps arriving meanwhile.
constexpr std::chrono::milliseconds kReplayLinks{1000}, kLiveLinks{300};
// Requests for the tiles: the store is connected, but its disk may be slow.
constexpr int kTries = 10;
constexpr std::int64_t kAskAgain_ns = 1'000'000'000;

// Why no sweep can be matched to these cubes, a sentence; empty: they can be used.
std::string why_refused(const std::vector<VoxelTile>& cubes,
                        const plane_map::PlaneMapConfig& config) {
  const auto other = std::ranges::find_if(
      cubes, [&](const VoxelTile& cube) { return !VoxelTiles::fits(cube, config); });
  if (other == cubes.end()) return {};
  std::ostringstream text;
  text << "the stored map was made with mapping.voxel_planes.root_voxel_m " << other->root_voxel_m
       << " and levels " << other->levels << ", this stage has " << config.root_voxel_m << " and "
       << config.levels << ": set the map's values, or another folder in store.path";
  return text.str();
}

}  // namespace

std::string MappingStage::voxel_key(const TileIndex& at) const {
  return stage_.keys().tile(kVoxelLayer, at.i, at.j, at.k);
}

void MappingStage::publish_voxels(const Sweep& sweep, double growth) {
  publish_voxels(sweep, mapper_.take_changed_voxels(growth));
}

void MappingStage::publish_voxels(const Sweep& sweep, const std::vector<VoxelTile>& tiles) {
  for (const VoxelTile& tile : tiles) {
    HeaderFields header = tile_.header(sweep);
    header.frame = "map";
    header.map_id = map_id_;
    tile_.publish_at(voxel_key(tile.index), header, voxel_message(header, tile));
  }
}

void MappingStage::leave_map(bool leaves) {
  if (!leaves) {
    if (last_mapped_) publish_voxels(*last_mapped_, left_voxels_);
    left_voxels_.clear();
    return;
  }
  // A connected store already has the cubes that have not changed since they were published.
  constexpr double kAll = -1.0;
  left_voxels_ = mapper_.take_changed_voxels(tile_.matching() ? 0.0 : kAll);
  if (std::exchange(answers_pose_, true)) return;
  const std::string pose = stage_.keys().of(Key::kMapOdometry);
  stage_.answer(pose, [this, pose](runtime::Answer& answer) {
    if (!last_pose_ || !answer.parameters().empty()) return;
    const auto& [header, fields] = *last_pose_;
    answer.reply(pose, encoding_of(Key::kMapOdometry), build(header, fields));
  });
}

// Creating a map supersedes the stored one; give the store time to answer first. A run that no
// other stage knows waits for a store only where one is deployed.
void MappingStage::wait_for_store(bool known_run) const {
  // The instance that was overtaken still runs for a moment and has the map.
  if (stage_.overtook()) return;
  const double wait_s =
      known_run ? std::max(kStoreLink_s, output_.store_link_s) : output_.store_link_s;
  const double up_s = 1e-9 * static_cast<double>(stage_.now_ns() - started_ns_);
  const std::chrono::duration<double> left(std::max(0.0, wait_s - up_s));
  runtime::wait_for_links([this] { return runtime::is_there(stage_, "store"); },
                          std::chrono::duration_cast<std::chrono::milliseconds>(left));
}

bool MappingStage::take_back(const msg::Header& first, SavedMap& saved, Lost& lost) {
  // Whoever lacks its map asks again soon, and sweeps wait meanwhile.
  const auto poses =
      runtime::recall_from<msg::MapPose>(stage_, stage_.keys().of(Key::kMapOdometry), 1, true,
                                         lacks_map_ ? runtime::kMemory : runtime::kStore);
  if (poses.empty()) return false;
  const runtime::Received<msg::MapPose>& pose = poses.back();
  const std::int64_t away_ns = first.stamp_ns() - pose->instant_ns();
  const bool same_run = pose.run() == first.run();
  const bool recent = static_cast<double>(away_ns) * 1e-9 < output_.take_back_s;
  const bool of_now = first.replay() ? same_run : recent && away_ns >= -1'000'000'000;
  // A map in which the robot is to be found may be of any age and of any run.
  if (!of_now && config_.mode == MappingMode::kMap) {
    runtime::log_info(
        "the stored map is of another time or run: creating a new one; mapping.mode localize or "
        "extend uses the stored one");
    return false;
  }
  lost.ids.add(pose.header().map_id());
  const int tries = lacks_map_ ? 1 : kTries;
  // The store and the previous instance may both send a cube: the newer one is kept.
  using TileMessage = runtime::Received<msg::MapTile>;
  std::map<std::tuple<std::string, int, int, int>, TileMessage> newest;
  const auto rank = [](const TileMessage& tile) {
    return std::pair(tile.header().term(), tile->version());
  };
  for (TileMessage& tile :
       runtime::recall_at<msg::MapTile>(stage_, stage_.keys().all_tiles(), tries, false)) {
    if (tile.header().map_id() != pose.header().map_id()) continue;
    const std::tuple at(tile->layer()->str(), tile->i(), tile->j(), tile->k());
    const auto [kept, is_new] = newest.try_emplace(at, tile);
    if (!is_new && rank(kept->second) < rank(tile)) kept->second = tile;
  }
  SavedMap stored;
  for (const auto& [at, tile] : newest) add_tile(*tile, stored);
  lost.why = why_refused(stored.voxels, config_.voxel_planes.map);
  if (!lost.why.empty() && config_.mode == MappingMode::kMap) return false;
  saved = std::move(stored);
  saved.instant_ns = pose->instant_ns();
  saved.odom_epoch = pose.header().odom_epoch();
  saved.T_map_base = pose_of(pose->pose_map_base());
  saved.twist_per_s = twist_of(pose->twist());
  map_id_ = pose.header().map_id();
  for (const auto& [at, tile] : newest) {
    if (tile.run() == first.run() && tile->layer()->str() == kVoxelLayer) {
      stored_sweep_ = std::max(stored_sweep_.value_or(0), tile.sweep());
    }
  }
  last_instant_ns_ = saved.instant_ns;
  // A replay from its beginning: an earlier replay of this recording stored the pose.
  if (same_run && !(first.replay() && first.sweep() == 0)) next_sweep_ = pose.sweep() + 1;
  // A pose without tiles or voxels is no map.
  return !saved.tiles.empty() || !saved.voxels.empty();
}

// Without a store the map is lost, but not its frame: integration has the last pose in it.
bool MappingStage::take_pose(const msg::Header& first, SavedMap& saved) {
  const auto poses =
      runtime::recall<msg::MapPose>(stage_, Key::kPose, runtime::sweeps_from(first.run(), 0), 1);
  // No sweep of this run has been mapped yet, so there is nothing to continue.
  if (next_sweep_ == 0 || (poses.empty() && !saved.T_map_odom)) return false;
  if (poses.empty()) {
    saved.T_map_base = *saved.T_map_odom;
    return true;
  }
  saved.T_map_base = pose_of(poses.back()->pose_map_base());
  saved.twist_per_s = twist_of(poses.back()->twist());
  last_instant_ns_ = saved.instant_ns = poses.back()->instant_ns();
  return true;
}

// Begins a map under an id of its own: readers and the store must not mix it with the lost one.
// False: the frame is lost too, or there was no map before.
bool MappingStage::begin_another(const msg::Header& first, const Lost& lost, SavedMap& saved) {
  const bool follows =
      lost.ids.newest() || runtime::may_follow_another(first.replay(), first.sweep(),
                                                       stage_.shared().recovery.keep_messages);
  if (follows) map_id_ = lost.ids.next(first.run(), first.sweep());
  const bool has_frame = take_pose(first, saved);
  if (has_frame) {
    stage_.degraded("map", runtime::lost_map_text(first.sweep(), lost.why));
  } else if (follows) {
    stage_.degraded("map", runtime::lost_frame_text(first.sweep(), lost.why));
  }
  return has_frame;
}

// Re-inserts the sweeps since the voxels were last published for the store. Without a store these
// are the sweeps still kept by others, and the map holds only the last seconds.
std::size_t MappingStage::insert_again(const msg::Header& first, std::uint64_t of_map,
                                       const std::vector<CorrectionMessage>& corrections) {
  const std::uint64_t from = stored_sweep_ ? *stored_sweep_ + 1 : 0;
  std::map<std::uint64_t, const CorrectionMessage*> inserted;
  for (const CorrectionMessage& correction : corrections) {
    const bool fits = correction.run() == first.run() && correction.sweep() >= from &&
                      correction.header().map_id() == of_map && correction->inserted();
    if (fits) inserted[correction.sweep()] = &correction;
  }
  if (inserted.empty()) return 0;
  const std::string wanted =
      runtime::sweeps_from(first.run(), inserted.begin()->first, inserted.rbegin()->first);
  std::size_t count = 0;
  for (const Sweep& sweep :
       runtime::recall<msg::OdometryFeatures>(stage_, Key::kOdometryFeatures, wanted, 1)) {
    const auto found = inserted.find(sweep.sweep());
    if (found == inserted.end()) continue;
    const CorrectionMessage& correction = *found->second;
    if (correction.header().odom_epoch() != sweep.header().odom_epoch()) continue;
    mapper_.insert_again(input_of(sweep), pose_of(correction->pose_map_odom()),
                         numbers_of(correction->state()));
    ++count;
  }
  return count;
}

// Begins no map, because the tiles of a new one would supersede the map of a store that is only
// late. Nothing is inserted until the robot is found, so every pose is Lost.
void MappingStage::do_without_map(const msg::Header& first, SavedMap& saved) {
  saved.found = false;
  mapper_.restore(saved);
  const bool localizes = config_.mode == MappingMode::kLocalize;
  stage_.degraded("map", std::string("mapping.mode is ") + (localizes ? "localize" : "extend") +
                             ", and no tile store has a map: every pose is Lost; start zloam-store "
                             "on the folder of a map (store.path)" +
                             (first.replay() ? " and replay again" : "") +
                             (localizes ? "" : ", or begin a map with command/mapping/reset"));
}

void MappingStage::ask_for_map(const msg::Header& now) {
  if (now.replay() || runtime::steady_ns() - asked_ns_ < kAskAgain_ns) return;
  asked_ns_ = runtime::steady_ns();
  if (!runtime::is_there(stage_, "store")) return;
  restart(now);
  if (lacks_map_) return;
  declare_tiles();
  place_as_told();
}

void MappingStage::restart(const msg::Header& first) {
  SavedMap saved;
  next_sweep_ = 0;
  asked_ns_ = runtime::steady_ns();
  // Whoever asks again has given the links their time.
  if (first.sweep() > 0 && !lacks_map_) {
    runtime::wait_for_links([this] { return correction_.matching(); },
                            first.replay() ? kReplayLinks : kLiveLinks);
  }
  const auto corrections =
      runtime::recall<msg::MapCorrection>(stage_, Key::kMapCorrection, runtime::kKept, 1);
  const auto of_this_run = [&](const auto& c) { return c.run() == first.run(); };
  wait_for_store(first.replay() || std::ranges::any_of(corrections, of_this_run));
  Lost lost;
  const bool has_map = take_back(first, saved, lost);
  bool found_before = false;
  // The stored pose is of this run.
  bool moved_from_there = next_sweep_ > 0;
  std::span<const std::uint64_t> state;
  for (const auto& correction : corrections) {
    if (correction.run() != first.run()) continue;
    state = {};
    next_sweep_ = std::max(next_sweep_, correction.sweep() + 1);
    lost.ids.add(correction.header().map_id());
    // Of a mapping that had no map: in no frame of this one.
    if (has_map && correction.header().map_id() != map_id_) continue;
    moved_from_there = true;
    found_before |= correction->inserted();
    if (correction.header().odom_epoch() != first.odom_epoch()) continue;
    saved.odom_epoch = first.odom_epoch();
    saved.T_map_odom = pose_of(correction->pose_map_odom());
    if (correction.sweep() + 1 == next_sweep_) state = numbers_of(correction->state());
  }
  const bool lacked = std::exchange(lacks_map_, !has_map && config_.mode != MappingMode::kMap);
  if (lacks_map_) {
    // Not the stored map's: a pose of it may have come without its tiles.
    map_id_ = first.run();
    if (!lacked) do_without_map(first, saved);
    return;
  }
  stage_.degraded("map", lost.why);
  if (!has_map && !begin_another(first, lost, saved)) return;
  saved.found = config_.mode == MappingMode::kMap || found_before;
  mapper_.restore(saved);
  last_T_map_base_ = saved.T_map_base;
  const std::uint64_t of_map = has_map ? map_id_ : lost.ids.newest().value_or(map_id_);
  const std::size_t again = insert_again(first, of_map, corrections);
  if (has_map) mapper_.resume(state);
  // The stored pose is of another run and the motion since then is unknown: the search starts at
  // the pose where that run ended.
  if (config_.mode != MappingMode::kMap && !moved_from_there) mapper_.place(saved.T_map_base);
  // The previous instance may not have written its file: write it even if nothing is added to the
  // map.
  file_.changed(mapper_.point_count() > 0);
  if (first.replay()) {
    inlet_->continue_at(first.run(), next_sweep_);
    ack_.done_below(first.run(), next_sweep_);
  }
  const std::size_t points = mapper_.point_count();
  stage_.figure("map_points_taken_back", static_cast<double>(points));
  runtime::log_warning("resuming the map of the previous instance",
                       {{"points", points},
                        {"voxel_cubes", saved.voxels.size()},
                        {"sweeps_again", again},
                        {"map_id", map_id_},
                        {"frame_known", saved.T_map_odom.has_value()}});
  runtime::Gap gap{.ns = first.stamp_ns() - last_instant_ns_};
  if (!first.replay() && next_sweep_ > 0) gap.add(next_sweep_, first.sweep());
  runtime::report(stage_, gap);
}

}  // namespace zloam::mapping
