#pragma once
// Buffers an inertial sensor's readings until the sweeps that they cover.

#include <cstdint>
#include <deque>
#include <limits>
#include <string>
#include <utility>
#include <vector>

#include "common/geometry/imu_reading.hpp"

namespace zloam::driver {

class ImuBuffer {
 public:
  /// delay_ns: by how much the stamps are later than the readings; it is subtracted. most: readings
  /// kept while no sweep takes them; of more the earliest are dropped and counted.
  explicit ImuBuffer(std::int64_t delay_ns, std::size_t most = kEndless)
      : delay_ns_(delay_ns), most_(most) {}

  /// Takes readings in ascending order of their stamps. One out of order, not finite or beyond
  /// 1e6 is dropped and counted; after a jump back by a second all earlier readings are dropped.
  /// False: dropped.
  bool add(const ImuReading& reading);
  /// Readings from begin to end with the margin on either side; drops the earlier ones.
  std::vector<ImuReading> covering(std::int64_t begin_ns, std::int64_t end_ns);
  /// Whether all readings of a sweep that ends then have arrived.
  bool reaches(std::int64_t end_ns) const;

  bool empty() const { return readings_.empty(); }
  std::int64_t first_ns() const { return readings_.front().stamp_ns; }
  std::int64_t last_ns() const { return readings_.back().stamp_ns; }
  std::uint64_t received() const { return received_; }
  std::uint64_t out_of_order() const { return out_of_order_; }
  std::uint64_t invalid() const { return invalid_; }
  std::uint64_t unused() const { return unused_; }

 private:
  static constexpr std::size_t kEndless = std::numeric_limits<std::size_t>::max();

  std::int64_t delay_ns_;
  std::size_t most_;
  std::deque<ImuReading> readings_;
  std::uint64_t received_ = 0;
  std::uint64_t out_of_order_ = 0;
  std::uint64_t invalid_ = 0;
  std::uint64_t unused_ = 0;
};

/// What is wrong with the units or signs of readings taken at about 1 g (conventions of REP
/// 145), a sentence; empty: nothing. Judged by the mean force in base_link, whose z axis is
/// up, in a robot's first seconds. Readings that the buffer drops do not count. R_base_imu: rotates
/// vectors of the sensor into base_link.
std::string wrong_units(const std::vector<ImuReading>& readings, const Eigen::Matrix3d& R_base_imu);

/// Judges a live sensor by its first second, with a provisional verdict before.
class UnitsJudge {
 public:
  explicit UnitsJudge(Eigen::Matrix3d R_base_imu) : R_base_imu_(std::move(R_base_imu)) {}

  /// Takes readings that the buffer has accepted: one with an earlier stamp is the first of a clock
  /// that was set back.
  void add(const ImuReading& reading);
  /// The verdict is final.
  bool judged() const { return judged_; }
  /// What is wrong by the readings so far, a sentence; empty: nothing.
  const std::string& wrong() const { return wrong_; }

 private:
  Eigen::Matrix3d R_base_imu_;
  std::vector<ImuReading> first_;
  bool judged_ = false;
  std::string wrong_;
};

}  // namespace zloam::driver
