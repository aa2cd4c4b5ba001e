#pragma once
// The stages of a robot, as services/stages.json has them (docs/add-a-stage.md).

#include <cstddef>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "common/messages/keys.hpp"

namespace zloam::runtime {

struct StageRow {
  std::string name;
  /// from the sensor to the pose or the map: a replay waits for it, and the monitor
  bool in_chain = false;
  /// any number of instances may work at once; else a second one stands by
  bool replicas = false;
  /// Patterns of the key table. What it has no sweep without, first; a publisher is not ready
  /// before its readers are there.
  std::vector<std::string> reads;
  /// What it has one of for each sweep, first.
  std::vector<std::string> writes;
};

/// In the order of the data, which is that of the ports: stage i listens on zenoh.base_port + i.
const std::vector<StageRow>& stage_list();

/// Position in the list; empty: no such stage.
std::optional<std::size_t> stage_place(std::string_view name);

/// Of the chain, but for its source: what a replay waits for.
std::vector<std::string> stages_behind_the_source();

/// Those that acknowledge what they have done: what paces a replay.
std::vector<std::string> acknowledging_stages();

/// Stages of the chain that have an input from the key: its publisher is not ready before them.
std::vector<std::string> readers_of(Key key);

/// How many stages publish something that another one reads.
std::size_t stages_that_are_read();

}  // namespace zloam::runtime
