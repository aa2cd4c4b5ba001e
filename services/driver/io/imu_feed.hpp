#pragma once
// Inertial readings for the driver's sweeps: from a file, or live from imu/<sensor>.

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "common/runtime/stage.hpp"
#include "driver/driver_parameters.hpp"
#include "driver/imu/imu_buffer.hpp"

namespace zloam::driver {

class ImuFeed {
 public:
  /// Reads the file, or subscribes, or waits for add(). Throws SourceError.
  ImuFeed(runtime::Stage& stage, const DriverConfig& config);

  /// Readings from the lidar's own packets, if configured.
  void add(const std::vector<ImuReading>& readings);
  bool on() const { return config_.imu != ImuChoice::kNone; }
  /// Throws SourceError when a replay's readings are of another time.
  void check_time_of(std::int64_t stamp_ns) const;
  /// Live: whether a sweep that ended then has to wait for its readings.
  bool lacks(std::int64_t end_ns) const;
  /// Readings of a sweep, valid until the next call.
  std::span<const msg::ImuSample> over(std::int64_t begin_ns, std::int64_t end_ns);
  /// Whether the last span ends before its sweep, or is empty.
  bool incomplete() const { return incomplete_; }
  void note_figures();

 private:
  void refuse_wrong_units(const std::vector<ImuReading>& first) const;
  void note_missing();
  void on_readings(const std::vector<ImuReading>& readings);
  bool usable() const { return units_.wrong().empty(); }

  runtime::Stage& stage_;
  DriverConfig config_;
  Eigen::Matrix3d R_base_imu_;
  ImuBuffer buffer_;
  std::vector<msg::ImuSample> samples_;
  bool incomplete_ = false;
  std::uint64_t sweeps_without_ = 0;
  std::uint64_t without_in_row_ = 0;
  /// of readings that come during the run; wrong ones are not used
  UnitsJudge units_;
  bool units_said_ = false;
};

}  // namespace zloam::driver
