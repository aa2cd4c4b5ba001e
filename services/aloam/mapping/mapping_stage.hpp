#pragma once
// A-LOAM's mapping on the runtime: messages in, messages, answers and files out.

#include <cstdint>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "aloam/config.hpp"
#include "aloam/core/scan_to_map.hpp"
#include "aloam/core/sensor_defaults.hpp"
#include "common/geometry/map_layer.hpp"
#include "common/runtime/map_output.hpp"
#include "common/runtime/stage.hpp"

namespace zloam::aloam {

/// Of section mapping: what the default stage reads under the same names and with the same meaning.
struct OutputConfig {
  std::string mode = "map";
  std::string map_path = "out/map.pcd";
  std::uint32_t publish_every = 5;
  std::uint32_t cloud_every = 50;
};

void bind(runtime::Parameters& parameters, OutputConfig& config);

class MappingStage {
 public:
  MappingStage(runtime::Stage& stage, const OutputConfig& output);

 private:
  using Sweep = runtime::Received<msg::OdometryFeatures>;

  void declare_answers();
  void new_run(const msg::Header& first);
  /// An instance before this one was in the middle of the run: goes on with what integration and
  /// the store keep; restart.cpp.
  void restart(const msg::Header& first);
  /// Nobody knows the map of that instance, nor its frame.
  void begin_unknown(const msg::Header& first);
  void take_back_tiles(std::uint64_t map_id, const Eigen::Vector3d& sensor);
  runtime::Outcome take(const Sweep& sweep);
  void process(const Sweep& sweep);
  void publish_pose(const Sweep& sweep, const Mapped& mapped, Health health);
  void publish_views(const Sweep& sweep);
  void publish_tiles(const Sweep& sweep);
  void publish_registered(const Sweep& sweep);
  void note_figures(const Mapped& mapped);
  Vector6 twist_since(std::int64_t instant_ns, const Pose& T_map_base) const;
  /// head: without its points
  Buffer tile_message(const HeaderFields& header, const CubeIndex& index, Layer layer,
                      bool head = false) const;
  Buffer cloud_message(const HeaderFields& header, bool whole) const;
  void answer_tiles(runtime::Answer& answer);
  runtime::CommandReply reset();
  /// Empty when written.
  std::string write_to(const std::string& path) const;
  runtime::OutputFiles::Run file_run() const;

  runtime::Stage& stage_;
  const OutputConfig& output_;
  Leaves leaves_;
  ScanToMap mapper_;
  runtime::Outlet& correction_;
  runtime::Outlet& pose_;
  runtime::Outlet& tile_;
  runtime::Outlet& surround_;
  runtime::Outlet& cloud_;
  runtime::Outlet& registered_;
  runtime::FlowAck& ack_;
  std::vector<msg::StampedPose> path_;
  std::set<CubeIndex> unpublished_;
  std::optional<std::uint64_t> prev_sweep_;
  std::optional<std::uint32_t> odom_epoch_;
  std::uint64_t mapped_ = 0;
  std::uint64_t map_id_ = 0;
  /// of this run: what is below was done by the instance before
  std::uint64_t next_sweep_ = 0;
  bool in_run_ = false;
  bool replay_ = false;
  runtime::MapOutput file_;
  std::optional<Sweep> last_mapped_;
  HeaderFields last_header_;
  std::int64_t last_instant_ns_ = 0;
  Pose last_T_map_base_ = Pose::Identity();
};

}  // namespace zloam::aloam
