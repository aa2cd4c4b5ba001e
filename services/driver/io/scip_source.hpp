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

/// As a mount file (driver.metadata) says; the defaults if the path is empty. Throws SourceError
/// that names file and key.
ScipSourceConfig read_mount_file(const std::string& path);

/// A source that also takes a motor's readings.
class ScipSource : public SweepSource {
 public:
  virtual void add(const spinning::AngleReading& reading) = 0;
};

/// Connects, and reconnects with growing pauses when the connection is lost. timeout_ms: longest
/// wait in one call of pull(). Throws SourceError when there is no such device at the start.
std::unique_ptr<ScipSource> sweeps_of_scanner(const std::string& device,
                                              const ScipSourceConfig& config, int timeout_ms);

/// angles: in order; empty for a scanner that does not rotate. Throws SourceError.
std::unique_ptr<ScipSource> sweeps_of_session(const std::string& path,
                                              const std::vector<spinning::AngleReading>& angles,
                                              const ScipSourceConfig& config);

/// For viewing a session alone: with its motor's profile or the angles beside it, or as a scanner
/// that does not rotate if there are none. Throws SourceError.
std::unique_ptr<ScipSource> sweeps_of_session(const std::string& path, ScipSourceConfig config);

/// "drive.csv" of "drive.logr". Throws SourceError when it is missing: without the motor's angles a
/// scanner sees one plane, which does not constrain motion in three dimensions.
std::string angles_beside(const std::string& session);

/// Why lines of a live scanner, or of a session, have no angle.
std::string no_angles_text(bool live);

/// A table with the columns t_ns and angle_rad. Throws SourceError.
std::vector<spinning::AngleReading> read_angle_file(const std::string& path);

}  // namespace zloam::driver
