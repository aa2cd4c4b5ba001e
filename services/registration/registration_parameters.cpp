#include "registration/registration_parameters.hpp"

#include "common/runtime/parameters.hpp"

namespace zloam::registration {
namespace {

void bind_points(runtime::Parameters& p, RegistrationConfig& c) {
  p.add("registration.min_range_m", &c.min_range_m, {0.0, 1000.0}, "m",
        "nearer points are left out")
      .live();
  p.add("registration.max_range_m", &c.max_range_m, {0.1, 10000.0}, "m",
        "farther points are left out")
      .live();
  p.add("registration.returns", &c.returns,
        {{"strongest", ReturnSelection::kStrongest},
         {"last", ReturnSelection::kLast},
         {"all", ReturnSelection::kAll}},
        "which returns of a firing with two are used")
      .live();
  p.add("registration.range_noise_m", &c.range_noise_m, {0.0001, 1.0}, "m",
        "one standard deviation of a range, from the sensor's data sheet");
  p.add("registration.min_points", &c.min_points, {0, 1e6}, "points",
        "fewer valid points make the sweep unhealthy")
      .live();
  p.check("registration.max_range_m", [&c] {
    return c.max_range_m > c.min_range_m ? "" : "must be above registration.min_range_m";
  });
}

void bind_curvature(runtime::Parameters& p, RegistrationConfig& c) {
  p.add("registration.half_window_min", &c.half_window_min, {1, 100}, "points",
        "neighbours on either side for the curvature, at least")
      .live();
  p.add("registration.half_window_max", &c.half_window_max, {1, 100}, "points",
        "neighbours on either side for the curvature, at most")
      .live();
  p.add("registration.window_width_m", &c.window_width_m, {0.0, 10.0}, "m",
        "width that the neighbourhood should span on near surfaces")
      .live();
  p.add("registration.edge_chi2", &c.edge_chi2, {0.0, 1e6}, "",
        "an edge's squared curvature exceeds so many times its variance")
      .live();
  p.add("registration.edge_min_bend_deg", &c.edge_min_bend_deg, {0.0, 180.0}, "deg",
        "the two sides of an edge meet at more than")
      .live();
  p.add("registration.flat_chi2", &c.flat_chi2, {0.0, 1e6}, "",
        "a flat point's squared curvature stays below so many variances")
      .live();
  p.check("registration.half_window_max", [&c] {
    return c.half_window_max >= c.half_window_min
               ? ""
               : "must not be below registration.half_window_min";
  });
}

void bind_selection(runtime::Parameters& p, RegistrationConfig& c) {
  p.add("registration.segments", &c.segments, {1, 100}, "",
        "parts of a ring with quotas of their own")
      .live();
  p.add("registration.sharp_per_segment", &c.sharp_per_segment, {0, 1000}, "points",
        "sharpest points of a segment")
      .live();
  p.add("registration.less_sharp_per_segment", &c.less_sharp_per_segment, {0, 1000}, "points",
        "less sharp points of a segment, with the sharp ones")
      .live();
  p.add("registration.flat_per_segment", &c.flat_per_segment, {0, 1000}, "points",
        "flattest points of a segment")
      .live();
  p.add("registration.suppression", &c.suppression, {0, 100}, "points",
        "neighbours on either side that a pick keeps from being picked")
      .live();
  p.add("registration.gap_min_m", &c.gap_min_m, {0.0, 100.0}, "m",
        "step in depth between neighbours that counts as the edge of an occlusion")
      .live();
  p.add("registration.occluded_points", &c.occluded_points, {0, 100}, "points",
        "points left out on the far side of an occlusion")
      .live();
  p.add("registration.parallel_tangent", &c.parallel_tangent, {0.0, 1000.0}, "",
        "tangent of the angle of incidence above which a surface is too oblique")
      .live();
  p.add("registration.drop_unreliable", &c.drop_unreliable,
        "leave oblique and occluded points out of the less flat cloud too")
      .live();
  p.add("registration.less_flat_leaf_m", &c.less_flat_leaf_m, {0.0, 10.0}, "m",
        "edge of the voxel filter over each ring's less flat points; 0: none")
      .live();
}

}  // namespace

void bind(runtime::Parameters& p, RegistrationConfig& c) {
  bind_points(p, c);
  bind_curvature(p, c);
  bind_selection(p, c);
}

void bind(runtime::Parameters& p, SharingConfig& c) {
  using runtime::Effect;
  p.add("registration.redo_live_ms", &c.redo_live_ms, {1, 10000}, "ms",
        "live: the replica of rank r does a sweep that is missing for r times so long",
        Effect::kNone);
  p.add("registration.redo_replay_ms", &c.redo_replay_ms, {1, 60000}, "ms", "the same in replay",
        Effect::kNone);
  p.add("registration.hold_sweeps", &c.hold_sweeps, {1, 1000}, "sweeps",
        "sweeps of other replicas held until odometry has their features", Effect::kNone);
  p.add("registration.hold_mib", &c.hold_mib, {1, 65536}, "MiB", "bound of the same",
        Effect::kNone);
}

}  // namespace zloam::registration
