#include "mapping/mapping_parameters.hpp"

#include "common/runtime/parameters.hpp"

namespace zloam::mapping {
namespace {

using runtime::Effect;
using runtime::Parameters;

void bind_map(Parameters& p, MappingConfig& c) {
  p.add("mapping.every", &c.every, {1, 1000}, "", "every n-th sweep by number is mapped");
  p.add("mapping.tile_edge_m", &c.tile_edge_m, {2.0, 1000.0}, "m", "edge of a cube of the map");
  p.add("mapping.window_tiles", &c.window_tiles, {1, 1001}, "",
        "cubes kept in memory around the sensor, x y z (odd)");
  p.add("mapping.local_tiles", &c.local_tiles, {1, 1001}, "",
        "cubes around the sensor that map/surround shows, x y z (odd)");
  p.add("mapping.leaf_edge_m", &c.leaf_edge_m, {0.02, 5.0}, "m", "one edge point a voxel");
  p.add("mapping.leaf_plane_m", &c.leaf_plane_m, {0.02, 5.0}, "m", "one plane point a voxel");
  p.add("mapping.founding_points", &c.founding_points, {1, 1e6}, "",
        "a map of fewer points is founded with sweeps that matched nothing")
      .live();
  p.add("mapping.archive_points", &c.archive_points, {0, 1e12}, "",
        "points of tiles outside the window that stay in memory; more go to a file", Effect::kNone);
  p.add("mapping.spill_directory", &c.spill_directory,
        "folder of that file; empty: all stay in memory", Effect::kNone);
  p.check("mapping.local_tiles", [&c]() -> std::string {
    for (std::size_t a = 0; a < 3; ++a) {
      if (c.local_tiles[a] > c.window_tiles[a]) return "must not exceed mapping.window_tiles";
    }
    return {};
  });
}

void bind_prediction(Parameters& p, MappingConfig& c) {
  p.add("mapping.prior_sigma_m", &c.prior_sigma_m, {1e-4, 10.0}, "m",
        "least sigma of the predicted position")
      .live();
  p.add("mapping.prior_sigma_rad", &c.prior_sigma_rad, {1e-5, 1.0}, "rad",
        "least sigma of the predicted rotation")
      .live();
  p.add("mapping.prior_scale", &c.prior_scale, {0.0, 1e4}, "",
        "the odometry's covariance counts this many times")
      .live();
  p.add("mapping.covariance_scale_m", &c.covariance_scale_m, {0.01, 1e3}, "",
        "published sigmas of the position: the solver's, times this")
      .live();
  p.add("mapping.covariance_scale_rad", &c.covariance_scale_rad, {0.01, 1e3}, "",
        "and of the rotation")
      .live();
  p.add("mapping.covariance_normal_error_rad", &c.covariance_normal_error_rad, {0.0, 1.0}, "rad",
        "errors of normals, by which the position's surest direction lends to the others")
      .live();
  p.add("mapping.covariance_map_m", &c.covariance_map_m, {0.0, 1e3}, "m",
        "added to the position, one sigma in each direction: what the map itself is off")
      .live();
  p.add("mapping.covariance_turn_share", &c.covariance_turn_share, {0.0, 10.0}, "",
        "added to the rotation: this share of what the turn changed by since the sweep before")
      .live();
  p.add("mapping.covariance_map_turn_rad", &c.covariance_map_turn_rad, {0.0, 1.0}, "rad",
        "a rotation known worse was drawn into the map too: variance v counts v (1 + v / this^2)")
      .live();
  p.add(
       "mapping.drift_limit", &c.drift_limit, {1e-6, 1.0}, "",
       "degenerate: the points leave a direction open by more than this share of 10 m, or of 1 rad")
      .live();
  p.add("mapping.bridge_distance_m", &c.bridge_distance_m, {0.0, 50.0}, "m",
        "how far around the last pose a new odometry frame is searched for")
      .live();
  p.add("mapping.bridge_rotation_rad", &c.bridge_rotation_rad, {0.0, 3.15}, "rad",
        "and how far it may be turned")
      .live();
  p.add("mapping.bridge_inlier_ratio", &c.bridge_inlier_ratio, {0.0, 1.0}, "",
        "share of features that must match before it is accepted")
      .live();
  p.add("mapping.bridge_sweeps", &c.bridge_sweeps, {1, 1e6}, "",
        "sweeps without an accepted match before the stage says lost")
      .live();
}

void bind_insertion(Parameters& p, MappingConfig& c) {
  p.add("mapping.insert_residual_factor", &c.insert_residual_factor, {1.0, 100.0}, "",
        "not inserted above this many medians of the recent residuals")
      .live();
  p.add("mapping.insert_residual_window", &c.insert_residual_window, {1, 1000}, "",
        "sweeps of that median");
  p.add("mapping.insert_distance_m", &c.insert_distance_m, {0.0, 100.0}, "m",
        "inserted when moved by more since the last one; 0: every sweep")
      .live();
  p.add("mapping.insert_rotation_rad", &c.insert_rotation_rad, {0.0, 3.15}, "rad",
        "or turned by more; 0: every sweep")
      .live();
}

void bind_voxel_map(Parameters& p, plane_map::PlaneMapConfig& c) {
  p.add("mapping.voxel_planes.root_voxel_m", &c.root_voxel_m, {0.1, 50.0}, "m",
        "edge of the coarsest voxels; each level halves it");
  p.add("mapping.voxel_planes.levels", &c.levels, {1, 6}, "", "sizes of voxels");
  p.add("mapping.voxel_planes.thickness_sigmas", &c.thickness_sigmas, {0.1, 20.0}, "",
        "a plane is thinner than this many sigmas of the range noise");
  p.add("mapping.voxel_planes.settled_points", &c.settled_points, {8, 1e6}, "",
        "a plane of so many points drops its finer voxels");
  p.add("mapping.voxel_planes.settled_far_points", &c.settled_far_points, {8, 1e6}, "",
        "so does one of so many points that the sensor has left behind");
  p.add("mapping.voxel_planes.settled_radius_m", &c.settled_radius_m, {1.0, 4000.0}, "m",
        "what is farther from the sensor is left behind");
  p.add("mapping.voxel_planes.planes_several_rings", &c.planes_several_rings,
        "a plane needs points of several rings");
  p.add("mapping.voxel_planes.one_ring_lead", &c.one_ring_lead, {0.0, 1.0}, "",
        "nor is it one of which a single ring gave more than this share of the points");
  p.add("mapping.voxel_planes.one_ring_thickness_sigmas", &c.one_ring_thickness_sigmas, {0.0, 20.0},
        "", "but for one thinner than this many sigmas of the range noise");
  p.add("mapping.voxel_planes.distributions", &c.distributions,
        "finest voxels without a plane count as lines and blobs");
  p.add("mapping.voxel_planes.keep_radius_m", &c.keep_radius_m, {10.0, 4000.0}, "m",
        "voxels farther from the sensor are dropped");
}

void bind_voxel_planes(Parameters& p, VoxelPlanesConfig& c) {
  bind_voxel_map(p, c.map);
  plane_map::MatcherConfig& m = c.matcher;
  p.add("mapping.voxel_planes.stride", &m.stride, {1, 100}, "",
        "every so many points of a sweep are matched")
      .live();
  p.add("mapping.voxel_planes.enough_points", &m.enough_points, {100, 1e7}, "points",
        "a denser sweep is matched with no fewer")
      .live();
  p.add("mapping.voxel_planes.enough_inserted_points", &m.enough_inserted_points, {100, 1e7},
        "points", "all are counted in the map; of a denser sweep no fewer than these")
      .live();
  p.add("mapping.voxel_planes.max_iterations", &m.max_iterations, {1, 100}, "", "at most").live();
  p.add("mapping.voxel_planes.correlation", &m.correlation, {1.0, 1e4}, "",
        "information of the residuals is divided by this")
      .live();
  p.add(
       "mapping.voxel_planes.crowd_points", &m.crowd_points, {0.0, 1e6}, "points",
       "of n points that meet surfaces facing one way in one voxel each counts 1 / (1 + n / this); "
       "0: each fully")
      .live();
  p.add("mapping.voxel_planes.change_sigma_m", &m.change_sigma_m, {1e-4, 10.0}, "m",
        "random change of the motion from sweep to sweep")
      .live();
  p.add("mapping.voxel_planes.change_sigma_rad", &m.change_sigma_rad, {1e-5, 1.0}, "rad",
        "and of the turn")
      .live();
  p.add("mapping.voxel_planes.weak_least_cosine", &m.weak_least_cosine, {0.0, 1.0}, "",
        "between walls, planes count along a weak direction that face it by at least this cosine");
  p.add("mapping.voxel_planes.tile_stride", &c.tile_stride, {1, 1000}, "",
        "every so many points of a sweep go into the tiles")
      .live();
  p.add("mapping.voxel_planes.enough_tile_points", &c.enough_tile_points, {100, 1e7}, "points",
        "of a denser sweep's surfaces no fewer than these")
      .live();
}

}  // namespace

void bind(Parameters& parameters, MappingConfig& config, OutputConfig& output) {
  bind_map(parameters, config);
  bind_prediction(parameters, config);
  bind_insertion(parameters, config);
  bind_voxel_planes(parameters, config.voxel_planes);
  parameters.add("mapping.map_path", &output.map_path,
                 "PCD file of the map at the end of a run; empty: none", Effect::kNone);
  parameters
      .add("mapping.publish_every", &output.publish_every, {1, 10000}, "",
           "changed tiles, surround and registered sweeps leave every n-th mapped sweep",
           Effect::kNone)
      .live();
  parameters
      .add("mapping.publish_growth", &output.publish_growth, {0.0, 10.0}, "",
           "a tile leaves when so much more was counted in it than when it left last",
           Effect::kNone)
      .live();
  parameters
      .add("mapping.cloud_every", &output.cloud_every, {1, 100000}, "",
           "the whole map leaves every n-th mapped sweep while someone listens", Effect::kNone)
      .live();
  parameters
      .add("mapping.voxels_every", &output.voxels_every, {1, 100000}, "",
           "what the store keeps of the voxels leaves every n-th mapped sweep", Effect::kNone)
      .live();
  parameters
      .add("mapping.voxels_growth", &output.voxels_growth, {0.0, 10.0}, "",
           "the same for the voxels of a place, and what may be missing there after a restart",
           Effect::kNone)
      .live();
  parameters.add(
      "mapping.take_back_s", &output.take_back_s, {0.0, 1e9}, "s",
      "live, when started: the store's map is gone on with when its last pose is younger",
      Effect::kNone);
  parameters.add("mapping.store_link_s", &output.store_link_s, {0.0, 60.0}, "s",
                 "so long after its start no map is founded before the store is there; 0: there is "
                 "none",
                 Effect::kNone);
}

}  // namespace zloam::mapping
