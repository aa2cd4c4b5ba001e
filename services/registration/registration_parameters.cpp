#include "registration/registration_parameters.hpp"

#include "common/runtime/parameters.hpp"

namespace zloam::registration {
namespace {

void bind_points(runtime::Parameters& p, RegistrationConfig& c) {
  p.add("registration.min_range_m", &c.min_range_m, {0.0, 1000.0}, "m",
        "minimum range; nearer points are dropped")
      .live();
  p.add("registration.max_range_m", &c.max_range_m, {0.1, 10000.0}, "m",
        "maximum range; farther points are dropped")
      .live();
  p.add("registration.returns", &c.returns,
        {{"strongest", ReturnSelection::kStrongest},
         {"last", ReturnSelection::kLast},
         {"all", ReturnSelection::kAll}},
        "returns used of a firing with two")
      .live();
  p.add("registration.range_noise_m", &c.range_noise_m, {0.0001, 1.0}, "m",
        "standard deviation of a range, from the sensor's data sheet");
  p.add("registration.min_points", &c.min_points, {0, 1e6}, "points",
        "minimum number of valid points; a sweep with fewer has health TooFewPoints")
      .live();
  p.check("registration.max_range_m",
          [&c] {
            return c.max_range_m > c.min_range_m ? "" : "must be above registration.min_range_m";
          },
          {"registration.min_range_m"});
}

void bind_features(runtime::Parameters& p, RegistrationConfig& c) {
  p.add("registration.edge_chi2", &c.edge_chi2, {0.0, 1e6}, "",
        "minimum squared curvature of an edge, in variances of its noise")
      .live();
  p.add("registration.less_flat_leaf_m", &c.less_flat_leaf_m, {0.0, 10.0}, "m",
        "voxel size of the filter for each ring's less flat points; 0: no filter")
      .live();
}

}  // namespace

void bind(runtime::Parameters& p, RegistrationConfig& c) {
  bind_points(p, c);
  bind_features(p, c);
}

void bind(runtime::Parameters& p, SharingConfig& c) {
  using runtime::Effect;
  p.add("registration.hold_sweeps", &c.hold_sweeps, {1, 1000}, "sweeps",
        "maximum number of other replicas' sweeps held until odometry has their features",
        Effect::kNone);
}

}  // namespace zloam::registration
