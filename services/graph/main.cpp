// zloam-graph: finds loop closures and poses that fit them. Everything of substance is in
// loop_graph.hpp (the method) and graph_stage.hpp (keys, files).

#include <memory>

#include "graph/graph_parameters.hpp"
#include "graph/graph_stage.hpp"

int main(int argc, char** argv) {
  zloam::graph::GraphConfig config;
  std::unique_ptr<zloam::graph::GraphStage> graph;
  return zloam::runtime::run_stage(
      argc, argv,
      {.name = "graph",
       .summary = "finds loop closures between submaps and optimizes their poses",
       .bind = [&](zloam::runtime::Parameters& p) { bind(p, config); },
       .wire =
           [&](zloam::runtime::Stage& stage) {
             graph = std::make_unique<zloam::graph::GraphStage>(stage, config);
           }});
}
