#pragma once
// Names of the graph's parameters in the robot's file.

#include "graph/config.hpp"

namespace zloam::runtime {
class Parameters;
}

namespace zloam::graph {

void bind(runtime::Parameters& parameters, GraphConfig& config);

}  // namespace zloam::graph
