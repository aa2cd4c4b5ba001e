#pragma once
// Wires the mapper to the runtime: takes messages, and produces messages, answers and files. Runs
// on the stage's one worker thread.

#include <map>
#include <optional>
#include <set>

#include "common/geometry/motion_check.hpp"
#include "common/runtime/lost_map.hpp"
#include "common/runtime/map_output.hpp"
#include "common/runtime/stage.hpp"
#include "mapping/mapping.hpp"
#include "mapping/mapping_parameters.hpp"
#include "mapping/odometry_watch.hpp"
#include "mapping/step_covariance.hpp"

namespace zloam::mapping {

class MappingStage {
 public:
  MappingStage(runtime::Stage& stage, const MappingConfig& config, const OutputConfig& output);

 private:
  using Sweep = runtime::Received<msg::OdometryFeatures>;

  void declare_answers();
  void declare_commands();
  void declare_tiles();
  void new_run(const msg::Header& first);
  void begin_run(const msg::Header& first);
  /// Restores what an earlier instance left; restart_stage.cpp.
  void restart(const msg::Header& first);
  /// Live: asks the store again for the map that it did not have, or was not there to give.
  void ask_for_map(const msg::Header& now);
  void do_without_map(const msg::Header& first, SavedMap& saved);
  void wait_for_store(bool known_run) const;
  using CorrectionMessage = runtime::Received<msg::MapCorrection>;
  struct Lost {
    runtime::EarlierIds ids;
    /// why the stored map can't be used; empty: it can, or there is none
    std::string why;
  };
  /// Takes map and pose from the store; false: it has no valid ones, or `lost` says why they can't
  /// be used. In a map that is only localized in, its points are taken all the same.
  bool take_back(const msg::Header& first, SavedMap& saved, Lost& lost);
  bool begin_another(const msg::Header& first, const Lost& lost, SavedMap& saved);
  bool take_pose(const msg::Header& first, SavedMap& saved);
  runtime::Outcome take(const Sweep& sweep);
  void process(const Sweep& sweep);
  MappingInput input_of(const Sweep& sweep);
  void publish_pose(const Sweep& sweep, const MappingResult& result);
  void publish_views(const Sweep& sweep, const MappingResult& result);
  /// Publishes the tiles that have grown by more than this share since they were published.
  void publish_tiles(const Sweep& sweep, double growth);
  void publish_voxels(const Sweep& sweep, double growth);
  /// Publishes the map for others to keep: what has grown enough, or all that has changed.
  void publish_map(const Sweep& sweep, bool all);
  void publish_submap(const Sweep& sweep, const std::optional<Submap>& submap);
  void forget_published();
  void publish_registered(const Sweep& sweep, const MappingResult& result);
  void note_figures(const MappingResult& result);
  Buffer cloud_message(const HeaderFields& header, const std::vector<LayeredPoint>& points) const;
  void answer_tiles(runtime::Answer& answer);
  std::string voxel_key(const TileIndex& at) const;
  void publish_voxels(const Sweep& sweep, const std::vector<VoxelTile>& tiles);
  /// Re-inserts the sweeps that the earlier instance inserted after the store's last copy.
  std::size_t insert_again(const msg::Header& first, std::uint64_t of_map,
                           const std::vector<CorrectionMessage>& corrections);
  /// Answers requests for what the store may lack: another mapping continues.
  void leave_map(bool leaves);
  void answer_cloud(runtime::Answer& answer, Key key, bool whole);
  void answer_path(runtime::Answer& answer);
  runtime::CommandReply reset();
  runtime::CommandReply place(const std::string& arguments_json);
  void place_as_told();
  /// Empty when written.
  std::string write_to(const std::string& path) const;
  runtime::OutputFiles::Run file_run() const;

  struct ToldPlace {
    double x_m, y_m, yaw_rad;
  };

  runtime::Stage& stage_;
  runtime::Inlet* inlet_ = nullptr;
  /// by a user, until the next mapped sweep: a run that begins before it starts there
  std::optional<ToldPlace> told_;
  /// another mapping continues with this map: the voxels that the store lacks
  std::vector<VoxelTile> left_voxels_;
  bool answers_pose_ = false;
  /// of this run, the newest sweep whose voxels came from the store
  std::optional<std::uint64_t> stored_sweep_;
  std::optional<std::pair<HeaderFields, MapPoseFields>> last_pose_;
  const MappingConfig& config_;
  const OutputConfig& output_;
  Mapper mapper_;
  MotionCheck motion_check_;
  runtime::Outlet& correction_;
  runtime::Outlet& pose_;
  runtime::Outlet& tile_;
  runtime::Outlet& surround_;
  runtime::Outlet& cloud_;
  runtime::Outlet& registered_;
  runtime::Outlet& submap_;
  runtime::FlowAck& ack_;
  StepCovariance step_covariance_;
  OdometryWatch watch_;
  std::uint64_t prev_mapped_ = 0;
  std::uint64_t mapped_ = 0;
  std::uint64_t map_id_ = 0;
  bool replay_ = false;
  /// of this run: lower sweeps were done by the earlier instance
  std::uint64_t next_sweep_ = 0;
  bool in_run_ = false;
  /// the robot is to be found in a stored map, which has not come
  bool lacks_map_ = false;
  std::int64_t started_ns_ = 0, asked_ns_ = 0;
  std::set<TileId> unpublished_;
  // Points counted in a tile when it was published.
  std::map<TileId, std::uint64_t> published_;
  std::optional<Sweep> last_mapped_;
  bool submaps_read_ = false;
  runtime::MapOutput file_;
  // Of the last mapped sweep, for replies.
  HeaderFields last_header_;
  std::int64_t last_instant_ns_ = 0;
  Pose last_T_map_base_ = Pose::Identity();
};

}  // namespace zloam::mapping
