#pragma once
// Sweeps of a simulated drive, computed on demand, for programs that read recordings.

#include <filesystem>
#include <memory>

#include "driver/io/sweep_source.hpp"
#include "motion.hpp"

namespace zloam::search {

class DriveSource : public driver::SweepSource {
 public:
  /// Throws std::invalid_argument if the file describes no drive, or a drive that is physically
  /// impossible (motion.hpp: Limits).
  explicit DriveSource(const std::filesystem::path& file);

  driver::Pull pull(driver::DecodedSweep& sweep) override;
  driver::NamedCounts counts() const override;

  /// Writes the lidar's poses every 2 ms from the first sweep to the end of the last one (TUM), and
  /// the extremes of the motion, one line `name value` each.
  void write_truth(const std::filesystem::path& tum, const std::filesystem::path& motion) const;

 private:
  DriveConfig config_;
  simulator::Scene scene_;
  Extremes extremes_;
  BeamLidar lidar_;
  std::uint32_t sweeps_;
  std::uint32_t next_ = 0;
  std::uint64_t cast_ = 0;
};

}  // namespace zloam::search
