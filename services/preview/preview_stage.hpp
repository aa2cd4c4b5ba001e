#pragma once
// Wires the preview to the runtime: takes the pose and, while the preview has a subscriber, the
// map's tiles; publishes key preview some times a second.

#include <cstdint>
#include <optional>
#include <string>

#include "common/runtime/all_tiles.hpp"
#include "common/runtime/on_demand.hpp"
#include "common/runtime/stage.hpp"
#include "preview/preview.hpp"

namespace zloam::preview {

class PreviewStage {
 public:
  explicit PreviewStage(runtime::Stage& stage);

 private:
  using PoseMessage = runtime::Received<msg::MapPose>;

  /// The newest pose, as it is published.
  struct Newest {
    HeaderFields header;
    PreviewFields fields;
    std::int64_t received_ns = 0;
  };

  void take(const PoseMessage& pose);
  /// Reports which map is being built.
  void take_mapped(const PoseMessage& mapped);
  void take_tile(const zenoh::Sample& sample);
  void take_tiles();
  void begin_map(std::uint64_t map_id);
  void every_period();
  void say();
  HeaderFields header() const;
  void note_figures(std::size_t bytes);

  runtime::Stage& stage_;
  runtime::Outlet& out_;
  runtime::OnDemand tiles_;
  runtime::AllTiles all_tiles_;
  Preview preview_;
  Pace pace_;
  std::optional<Newest> newest_;
  std::optional<std::uint64_t> map_id_;
  std::uint32_t epoch_ = 0;
};

}  // namespace zloam::preview
