#include "drive_source.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <stdexcept>

#include "drive_file.hpp"

namespace zloam::search {
namespace {

constexpr std::int64_t kEpochNs = 1'704'067'210'000'000'000;

}  // namespace

DriveSource::DriveSource(const std::filesystem::path& file)
    : config_(read_drive(file.string())),
      scene_(scene_of(config_)),
      extremes_(extremes(scene_, config_)),
      lidar_(scene_, config_.lidar, config_.seed),
      sweeps_(sweep_count(scene_, config_)) {
  require_possible(extremes_, Limits{});
}

driver::Pull DriveSource::pull(driver::DecodedSweep& sweep) {
  while (std::binary_search(config_.dropped.begin(), config_.dropped.end(), next_)) ++next_;
  if (next_ >= sweeps_) return driver::Pull::kEnd;
  const auto start_ns =
      std::llround(config_.start_s * 1e9) + static_cast<std::int64_t>(next_) * lidar_.period_ns();
  Turn turn = lidar_.turn(start_ns);
  sweep = {};
  sweep.points = std::move(turn.points);
  sweep.columns.assign(sweep.points.size(), 0);
  sweep.stamp_ns = kEpochNs + turn.first_ns;
  sweep.period_ns = lidar_.period_ns();
  sweep.rings = lidar_.rings();
  sweep.model = "simulated";
  sweep.clock_source = driver::ClockSource::kSynthetic;
  sweep.complete = true;
  ++next_;
  ++cast_;
  return driver::Pull::kSweep;
}

driver::NamedCounts DriveSource::counts() const { return {{"scans", cast_}}; }

void DriveSource::write_truth(const std::filesystem::path& tum,
                              const std::filesystem::path& motion) const {
  constexpr std::int64_t kStepNs = 2'000'000;
  std::ofstream file(tum);
  const auto from_ns = std::llround(config_.start_s * 1e9);
  // With a field of view that begins late in the revolution, a sweep's instant can lie after the
  // end of the last revolution.
  const std::int64_t to_ns =
      from_ns + (static_cast<std::int64_t>(sweeps_) + 1) * lidar_.period_ns();
  for (std::int64_t t = from_ns; t <= to_ns; t += kStepNs) {
    const Pose pose = scene_.trajectory.at(static_cast<double>(t) * 1e-9).T_world_body;
    const Eigen::Quaterniond q(pose.linear());
    const Eigen::Vector3d& p = pose.translation();
    const auto stamp = static_cast<long long>(kEpochNs + t);
    char line[256];
    std::snprintf(line, sizeof line, "%lld.%09lld %.9f %.9f %.9f %.12f %.12f %.12f %.12f\n",
                  stamp / 1000000000, stamp % 1000000000, p.x(), p.y(), p.z(), q.x(), q.y(), q.z(),
                  q.w());
    file << line;
  }
  std::ofstream figures(motion);
  figures << "sweeps " << sweeps_ << "\nspeed_mps " << extremes_.speed_mps << "\nacceleration_mps2 "
          << extremes_.acceleration_mps2 << "\nrate_radps " << extremes_.rate_radps
          << "\nangular_acceleration_radps2 " << extremes_.angular_acceleration_radps2
          << "\nnearest_m " << extremes_.nearest_m << "\n";
  file.close();
  figures.close();
  if (!file || !figures) throw std::runtime_error(tum.string() + ": the truth can't be written");
}

}  // namespace zloam::search
