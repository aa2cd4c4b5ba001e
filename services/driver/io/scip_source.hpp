#pragma once
// Sweeps of a Hokuyo scanner, live or recorded, with the angles of its motor.

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "driver/io/sweep_source.hpp"
#include "driver/scip/client.hpp"
#include "driver/spinning/sweeps.hpp"

namespace zloam::driver {

struct ScipSourceConfig {
  scip::ClientConfig client;
  spinning::SpinningConfig spinning;
};

/// A source to which a motor's readings are given as they come.
class ScipSource : public SweepSource {
 public:
  virtual void add(const spinning::AngleReading& reading) = 0;
};

/// Connects, and again with growing pauses when the connection goes. timeout_ms: how long one call
/// of pull() may wait. Throws SourceError when there is no such device at the start.
std::unique_ptr<ScipSource> sweeps_of_scanner(const std::string& device,
                                              const ScipSourceConfig& config, int timeout_ms);

/// angles: in their order; empty for a scanner that stands still. Throws SourceError.
std::unique_ptr<ScipSource> sweeps_of_session(const std::string& path,
                                              const std::vector<spinning::AngleReading>& angles,
                                              const ScipSourceConfig& config);

/// For looking at a session alone: turned by the angles beside it, or as of a scanner that stands
/// still where there are none. Throws SourceError.
std::unique_ptr<ScipSource> sweeps_of_session(const std::string& path, ScipSourceConfig config);

/// "drive.csv" of "drive.logr". Throws SourceError when it is not there: without the motor's angles
/// a scanner sees one plane, in which no motion in three dimensions can be found.
std::string angles_beside(const std::string& session);

/// A table with the columns t_ns and angle_rad. Throws SourceError.
std::vector<spinning::AngleReading> read_angle_file(const std::string& path);

}  // namespace zloam::driver
