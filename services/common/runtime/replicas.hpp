#pragma once
// Between a stage that may have replicas (registration) and its reader (odometry): what the reader
// takes and reports, and what a replica reports of a sweep that it dropped.

#include <cstdint>
#include <string>

#include "common/runtime/stage.hpp"

namespace zloam::runtime {

/// Options of the reader: of any number of replicas, the first copy of a sweep is taken that was
/// made with the configuration in force. of: the stage that has replicas.
InletOptions from_replicas(Stage& stage, std::string of);

/// Reports to the replicas which sweeps of the run are still to be processed. header: made by
/// `progress`.
void publish_progress(const Stage& stage, Outlet& progress, const Inlet& input, HeaderFields header,
                      std::uint64_t run, std::uint64_t next_sweep);

/// An empty message tells odometry not to wait for a sweep that was dropped here. sweeps: the input
/// of the driver's sweeps. last: the header of the features published last.
void publish_dropped(const Stage& stage, Outlet& features, const Inlet& sweeps,
                     const HeaderFields& last, std::uint64_t run, std::uint64_t sweep);

}  // namespace zloam::runtime
