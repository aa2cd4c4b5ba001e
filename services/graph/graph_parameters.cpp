#include "graph/graph_parameters.hpp"

#include "common/runtime/parameters.hpp"

namespace zloam::graph {

void bind(runtime::Parameters& p, GraphConfig& c) {
  p.add("graph.loop_way_m", &c.loop_way_m, {1.0, 1e6}, "m",
        "minimum distance travelled between two submaps that may close a loop");
  p.add("graph.drift_share", &c.drift_share, {1e-5, 1.0}, "",
        "assumed drift of mapping beyond the published covariance: share of the distance "
        "travelled, one sigma");
  p.add("graph.drift_rad_per_m", &c.drift_rad_per_m, {1e-7, 1.0}, "rad/m",
        "assumed drift of mapping's heading beyond the published covariance, per metre travelled, "
        "one sigma");
  p.add("graph.output_dir", &c.output_dir,
        "folder of trajectory_world.tum and map_world.pcd (further runs: trajectory_world_2.tum "
        "and so on); empty: no files",
        runtime::Effect::kNone);
}

}  // namespace zloam::graph
