#include "common/runtime/replicas.hpp"

#include <algorithm>
#include <utility>

namespace zloam::runtime {

InletOptions from_replicas(Stage& stage, std::string of) {
  InletOptions options;
  options.replicas = true;
  options.admit = [&stage, of = std::move(of)](const Message& message) {
    return stage.revision_agrees(of, *message.header);
  };
  return options;
}

void publish_progress(const Stage& stage, Outlet& progress, const Inlet& input, HeaderFields header,
                      std::uint64_t run, std::uint64_t next_sweep) {
  ProgressFields fields;
  fields.run = run;
  fields.instance = stage.identity().instance;
  fields.next_sweep = next_sweep;
  const Arrivals arrivals = input.arrivals();
  fields.received_below = std::max(arrivals.received_below, next_sweep);
  fields.missing = arrivals.missing;
  fields.seq = header.seq;
  header.run = run;
  progress.publish(header, build(fields));
}

void publish_dropped(const Stage& stage, Outlet& features, const Inlet& sweeps,
                     const HeaderFields& last, std::uint64_t run, std::uint64_t sweep) {
  HeaderFields header = features.header(stage.now_ns(), stage.now_ns());
  header.run = run;
  header.sweep = sweep;
  header.frame = "lidar";
  header.stamp_ns = last.stamp_ns;
  // The driver's term, as in all features: a lower one would be rejected as that of a superseded
  // instance. A sweep may be given up before any was processed here.
  header.term = sweeps.term();
  header.config_rev = stage.config_rev(run, sweep);
  features.publish(header, build(header, FeaturesFields{.health = Health::kDropped}));
}

}  // namespace zloam::runtime
