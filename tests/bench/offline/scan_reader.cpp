#include "scan_reader.hpp"

#include <cmath>
#include <numbers>

#include "drive_source.hpp"
#include "driver/io/scip_source.hpp"

namespace zloam::offline {
namespace {

namespace fs = std::filesystem;

std::unique_ptr<driver::SweepSource> open_session(const fs::path& path,
                                                  const ReadOptions& options) {
  driver::ScipSourceConfig config;
  config.spinning.sweep_s = options.sweep_s;
  config.client.stamp_offset_ns = std::llround(1e3 * options.stamp_offset_us);
  return driver::sweeps_of_session(path.string(), config);
}

std::unique_ptr<driver::SweepSource> open(const fs::path& path, const ReadOptions& options) {
  if (path.extension() == ".yaml") return std::make_unique<search::DriveSource>(path);
  if (fs::is_directory(path)) {
    if (fs::exists(path / "stamps.txt")) {
      return driver::sweeps_of_scans(driver::open_synth(path.string()));
    }
    return driver::sweeps_of_scans(driver::open_kitti(path.string(), options.timing));
  }
  if (path.extension() == ".logr") return open_session(path, options);
  const bool bare = path.extension() == ".bin";
  driver::PacketStreamConfig stream;
  stream.assembler.clock_mode =
      bare ? driver::ClockMode::kFreeRunning : driver::ClockMode::kReceive;
  const std::size_t payload_bytes = driver::Makers(stream.decoding).maker().payload_bytes();
  return driver::sweeps_of_packets(bare ? driver::open_payload_file(path.string(), payload_bytes)
                                        : driver::open_pcap(path.string()),
                                   stream, 0);
}

// Changes every return as if the sensor's elevations and ranges had these calibration errors.
void bend(PointVector& points, const ReadOptions& options) {
  if (options.elevation_offset_deg == 0.0 && options.range_offset_m == 0.0) return;
  const double turn = options.elevation_offset_deg * std::numbers::pi / 180.0;
  for (Point& p : points) {
    const double flat = std::hypot(p.x, p.y);
    const double range = std::hypot(flat, double(p.z));
    if (flat <= 0.0) continue;
    const double elevation = std::atan2(double(p.z), flat) + turn;
    const double wanted = range + options.range_offset_m;
    const double scale = wanted * std::cos(elevation) / flat;
    p.x = static_cast<float>(p.x * scale);
    p.y = static_cast<float>(p.y * scale);
    p.z = static_cast<float>(wanted * std::sin(elevation));
  }
}

}  // namespace

ScanReader::ScanReader(const fs::path& path, const ReadOptions& options)
    : options_(options), source_(open(path, options)) {}

void ScanReader::write_truth(const fs::path& folder) const {
  if (const auto* drive = dynamic_cast<const search::DriveSource*>(source_.get())) {
    drive->write_truth(folder / "truth.tum", folder / "motion.txt");
  }
}

bool ScanReader::next(Scan& scan) {
  driver::DecodedSweep sweep;
  driver::Pull pulled = source_->pull(sweep);
  while (pulled == driver::Pull::kNothing) pulled = source_->pull(sweep);
  if (pulled != driver::Pull::kSweep) return false;
  scan.stamp_ns = sweep.stamp_ns;
  scan.period_ns = sweep.period_ns;
  scan.rings = sweep.rings;
  scan.slices = sweep.slices;
  // KITTI's layout of 16 bytes per point cannot express it, so an option does.
  scan.deskewed = sweep.deskewed || options_.timing.model == driver::TimeModel::kDeskewed;
  scan.points = std::move(sweep.points);
  bend(scan.points, options_);
  return true;
}

}  // namespace zloam::offline
