#pragma once
// Folders of scan files, read in the order of the numbers in their names. Complete points of a scan
// are used; incomplete and missing scans are reported.

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "common/geometry/imu_reading.hpp"
#include "driver/io/packet_source.hpp"
#include "driver/scan/scan.hpp"

namespace zloam::driver {

class ScanFolder {
 public:
  virtual ~ScanFolder() = default;
  /// The next scan; false at the end. Throws SourceError, naming the file.
  virtual bool next(DecodedSweep& sweep) = 0;
  /// All files that the sweeps depend on, for the identity of a replay.
  virtual const std::vector<std::string>& files() const = 0;
  virtual NamedCounts counts() const = 0;
  /// Sentences about problems; grows.
  virtual std::vector<std::string> remarks() const = 0;
  /// Inertial readings that came with the scans since the last call.
  virtual std::vector<ImuReading> take_imu() { return {}; }
};

/// <path>/velodyne/*.bin, or *.bin in path itself. Times: <path>/times.txt (seconds, one per line,
/// of the revolution's begin) if present, otherwise from the names, or scan k begins at k periods.
/// A timing without a model is refused, and so are scans that no lidar can have produced.
std::unique_ptr<ScanFolder> open_kitti(const std::string& path, const ScanTiming& timing);

/// <path>/scans/*.bin and <path>/stamps.txt (begin and end of each scan, s).
std::unique_ptr<ScanFolder> open_synth(const std::string& path);

}  // namespace zloam::driver
