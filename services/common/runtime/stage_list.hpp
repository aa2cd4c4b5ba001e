#pragma once
// The stages of a robot, from services/stages.json (docs/add-a-stage.md).

#include <cstddef>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "common/messages/keys.hpp"

namespace zloam::runtime {

struct StageRow {
  std::string name;
  /// on the way from the sensor to pose or map: a replay and the monitor wait for it
  bool in_chain = false;
  /// any number of instances may work at once; else a second one stands by
  bool replicas = false;
  /// Patterns of the key table. The input that defines its sweeps is first; a publisher is not
  /// ready before its readers are there.
  std::vector<std::string> reads;
  /// The output with one message for each sweep is first.
  std::vector<std::string> writes;
};

/// In the order of the data flow and of the ports: stage i listens on zenoh.base_port + i.
const std::vector<StageRow>& stage_list();

/// Position in the list; empty: no such stage.
std::optional<std::size_t> stage_place(std::string_view name);

/// The stages of the chain without its source: a replay waits for them.
std::vector<std::string> stages_behind_the_source();

/// The stages that acknowledge finished sweeps: they pace a replay.
std::vector<std::string> acknowledging_stages();

/// Stages of the chain that have an input from the key: its publisher is not ready before them.
std::vector<std::string> readers_of(Key key);

/// Number of stages that publish something that another stage reads.
std::size_t stages_that_are_read();

}  // namespace zloam::runtime
