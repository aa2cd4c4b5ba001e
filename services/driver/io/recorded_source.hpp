#pragma once
// Sources of a replay: a capture, bare payloads, a folder of scans, a bag.

#include <memory>
#include <string>
#include <vector>

#include "common/runtime/config.hpp"
#include "driver/driver_parameters.hpp"
#include "driver/io/sweep_source.hpp"

namespace zloam::driver {

struct RecordedSource {
  std::unique_ptr<SweepSource> sweeps;
  /// the replay's number is made from this text and the bytes of these files
  std::string identity;
  std::vector<std::string> files;
};

/// Throws SourceError.
RecordedSource open_recorded(const DriverConfig& config, const runtime::SharedConfig& shared);

}  // namespace zloam::driver
