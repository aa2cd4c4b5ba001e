#include "driver/imu/imu_buffer.hpp"

#include <algorithm>
#include <cstdio>
#include <optional>

#include "common/geometry/imu_limits.hpp"

namespace zloam::driver {
namespace {

// If the clock was set back by more than this, the readings start again.
constexpr std::int64_t kRestart_ns = 1'000'000'000;
// The verdict on the units is final after this time, or after more readings than a sensor gives in
// it.
constexpr std::int64_t kJudge_ns = 1'000'000'000;
constexpr std::size_t kMostJudged = 5'000;
constexpr double kGravity_mps2 = 9.80665;
// A platform's acceleration changes the mean force of a second by less than half of g.
constexpr double kLeastForce_mps2 = 0.5 * kGravity_mps2;
constexpr double kMostForce_mps2 = 2.0 * kGravity_mps2;

std::string with_value(const char* format, double value) {
  char text[256];
  std::snprintf(text, sizeof text, format, value);
  return text;
}

/// False for NaN too.
bool is_plausible(const Eigen::Vector3d& v) { return (v.array().abs() <= kMostOfReading).all(); }

bool is_plausible(const ImuReading& reading) {
  return is_plausible(reading.force_mps2) && is_plausible(reading.rate_radps);
}

/// Of the plausible readings; nothing if there is none.
std::optional<Eigen::Vector3d> mean_force(const std::vector<ImuReading>& readings) {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  std::size_t count = 0;
  for (const ImuReading& r : readings) {
    if (!is_plausible(r)) continue;
    sum += r.force_mps2;
    ++count;
  }
  if (count == 0) return std::nullopt;
  return sum / static_cast<double>(count);
}

}  // namespace

bool ImuBuffer::add(const ImuReading& reading) {
  ++received_;
  if (!is_plausible(reading)) {
    ++invalid_;
    return false;
  }
  ImuReading shifted = reading;
  shifted.stamp_ns -= delay_ns_;
  if (!readings_.empty() && shifted.stamp_ns <= readings_.back().stamp_ns) {
    ++out_of_order_;
    if (readings_.back().stamp_ns - shifted.stamp_ns < kRestart_ns) return false;
    readings_.clear();
  }
  readings_.push_back(shifted);
  if (readings_.size() > most_) {
    readings_.pop_front();
    ++unused_;
  }
  return true;
}

std::vector<ImuReading> ImuBuffer::covering(std::int64_t begin_ns, std::int64_t end_ns) {
  while (!readings_.empty() && readings_.front().stamp_ns < begin_ns - kImuMargin_ns) {
    readings_.pop_front();
  }
  const auto after = std::upper_bound(
      readings_.begin(), readings_.end(), end_ns + kImuMargin_ns,
      [](std::int64_t time_ns, const ImuReading& r) { return time_ns < r.stamp_ns; });
  return {readings_.begin(), after};
}

bool ImuBuffer::reaches(std::int64_t end_ns) const {
  return !readings_.empty() && readings_.back().stamp_ns >= end_ns;
}

std::string wrong_units(const std::vector<ImuReading>& readings,
                        const Eigen::Matrix3d& R_base_imu) {
  const auto mean_of_sensor = mean_force(readings);
  if (!mean_of_sensor) return {};
  const Eigen::Vector3d mean = R_base_imu * *mean_of_sensor;
  const double norm = mean.norm();
  if (norm > 0.8 && norm < 1.2) {
    return with_value(
        "its force is %.2f, as of a sensor that reads in g: m/s^2 are wanted (factor 9.80665)",
        norm);
  }
  if (norm < kLeastForce_mps2) {
    return with_value(
        "its force is %.2f m/s^2, without gravity: the specific force is wanted, +g on z at rest",
        norm);
  }
  if (norm > kMostForce_mps2) {
    return with_value("its force is %.0f, no m/s^2: is it uncalibrated?", norm);
  }
  if (mean.z() < -kLeastForce_mps2) {
    return with_value(
        "its force along base_link's z is %.2f m/s^2, where +g is expected: is gravity's sign "
        "turned, or mounting.imu_rpy_deg wrong?",
        mean.z());
  }
  return {};
}

void UnitsJudge::add(const ImuReading& reading) {
  if (judged_) return;
  if (!first_.empty() && reading.stamp_ns <= first_.back().stamp_ns) first_.clear();
  first_.push_back(reading);
  wrong_ = wrong_units(first_, R_base_imu_);
  const bool second = reading.stamp_ns - first_.front().stamp_ns >= kJudge_ns;
  if (!second && first_.size() < kMostJudged) return;
  judged_ = true;
  first_ = {};
}

}  // namespace zloam::driver
