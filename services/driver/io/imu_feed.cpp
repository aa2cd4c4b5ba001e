#include "driver/io/imu_feed.hpp"

#include <cmath>
#include <limits>

#include "common/messages/convert.hpp"
#include "driver/io/imu_file.hpp"
#include "schemas/imu_generated.h"

namespace zloam::driver {
namespace {

// The readings of the first second decide whether the units are right.
constexpr std::int64_t kJudge_ns = 1'000'000'000;
// A sweep does not wait for readings of a sensor that has been silent for this long.
constexpr std::int64_t kSilent_ns = 200'000'000;
// Sweeps in a row without readings before it is reported.
constexpr std::uint64_t kSaidAfter = 10;

std::vector<ImuReading> of_first(const std::vector<ImuReading>& readings, std::int64_t span_ns) {
  std::vector<ImuReading> first;
  for (const ImuReading& r : readings) {
    if (r.stamp_ns - readings.front().stamp_ns > span_ns) break;
    first.push_back(r);
  }
  return first;
}

/// A file's readings are in the buffer before the first sweep; those of a live sensor, of 400 and
/// more in a second, must not fill the memory while no sweep comes.
std::size_t most_readings(ImuChoice imu) {
  constexpr std::size_t kMostLive = 20'000;
  return imu == ImuChoice::kFile ? std::numeric_limits<std::size_t>::max() : kMostLive;
}

}  // namespace

ImuFeed::ImuFeed(runtime::Stage& stage, const DriverConfig& config)
    : stage_(stage),
      config_(config),
      R_base_imu_(stage.shared().mounting.T_base_imu().linear()),
      buffer_(std::llround(1e6 * config.imu_delay_ms), most_readings(config.imu)),
      units_(R_base_imu_) {
  if (config_.imu == ImuChoice::kFile) {
    const std::vector<ImuReading> readings = read_imu_file(config_.imu_path);
    refuse_wrong_units(of_first(readings, kJudge_ns));
    if (const std::string text = standstill_in(readings); !text.empty()) {
      runtime::log_warning(config_.imu_path + ": " + text);
      stage_.degraded("imu file", config_.imu_path + ": " + text);
    }
    for (const ImuReading& r : readings) buffer_.add(r);
    if (buffer_.empty()) throw SourceError(config_.imu_path + ": has no reading below 1e6");
  } else if (config_.imu == ImuChoice::kZenoh) {
    runtime::InletOptions options;
    options.order = runtime::Order::kAsTheyCome;
    options.lossless = true;
    options.outside_runs = true;
    stage.inlet<msg::ImuBatch>(Key::kImu, options,
                               [this](const runtime::Received<msg::ImuBatch>& batch) {
                                 on_readings(imu_of(batch->samples()));
                               });
  }
}

void ImuFeed::refuse_wrong_units(const std::vector<ImuReading>& first) const {
  const std::string wrong = wrong_units(first, R_base_imu_);
  if (!wrong.empty()) throw SourceError(config_.imu_path + ": " + wrong);
}

void ImuFeed::check_time_of(std::int64_t stamp_ns) const {
  if (config_.imu != ImuChoice::kFile) return;
  if (stamp_ns >= buffer_.first_ns() - kJudge_ns && stamp_ns <= buffer_.last_ns()) return;
  const bool after = stamp_ns < buffer_.first_ns();
  const double apart_s = 1e-9 * static_cast<double>(after ? buffer_.first_ns() - stamp_ns
                                                          : stamp_ns - buffer_.last_ns());
  throw SourceError(config_.imu_path + ": its readings are of " +
                    std::to_string(buffer_.first_ns()) + " to " +
                    std::to_string(buffer_.last_ns()) + " ns, the first sweep is of " +
                    std::to_string(stamp_ns) + " ns: they " + (after ? "begin " : "end ") +
                    std::to_string(apart_s) + " s " + (after ? "after" : "before") +
                    " it; times of one clock are wanted, and readings from the first sweep on");
}

void ImuFeed::add(const std::vector<ImuReading>& readings) {
  if (config_.imu == ImuChoice::kSensor) on_readings(readings);
}

void ImuFeed::on_readings(const std::vector<ImuReading>& readings) {
  for (const ImuReading& r : readings) {
    if (buffer_.add(r)) units_.add(r);
  }
  if (units_said_ || !units_.judged() || usable()) return;
  units_said_ = true;
  const std::string text = "the inertial sensor is not used: " + units_.wrong();
  runtime::log_warning(text);
  stage_.degraded("imu", text);
}

bool ImuFeed::lacks(std::int64_t end_ns) const {
  const bool live = config_.imu == ImuChoice::kZenoh || config_.imu == ImuChoice::kSensor;
  return live && usable() && !buffer_.empty() && !buffer_.reaches(end_ns) &&
         end_ns - buffer_.last_ns() < kSilent_ns;
}

std::span<const msg::ImuSample> ImuFeed::over(std::int64_t begin_ns, std::int64_t end_ns) {
  samples_.clear();
  if (on() && usable()) {
    for (const ImuReading& r : buffer_.covering(begin_ns, end_ns)) {
      samples_.push_back(zloam::to_message(r));
    }
  }
  incomplete_ = on() && (samples_.empty() || samples_.back().stamp_ns() < end_ns);
  if (on() && usable()) note_missing();
  return samples_;
}

void ImuFeed::note_missing() {
  const bool was_said = without_in_row_ >= kSaidAfter;
  without_in_row_ = incomplete_ ? without_in_row_ + 1 : 0;
  sweeps_without_ += incomplete_ ? 1 : 0;
  if (without_in_row_ == kSaidAfter) {
    const std::string text =
        "sweeps have no inertial readings that cover them: do they come (imu/<sensor>, "
        "driver.imu_path, driver.position_port), and are their stamps of the lidar's clock?";
    runtime::log_warning(text);
    stage_.degraded("imu", text);
  } else if (was_said && without_in_row_ == 0) {
    runtime::log_info("inertial readings come again");
    stage_.degraded("imu", "");
  }
}

void ImuFeed::note_figures() {
  if (!on()) return;
  stage_.figure("imu_readings", static_cast<double>(buffer_.received()));
  stage_.figure("imu_out_of_order", static_cast<double>(buffer_.out_of_order()));
  stage_.figure("imu_invalid", static_cast<double>(buffer_.invalid()));
  stage_.figure("imu_unused", static_cast<double>(buffer_.unused()));
  stage_.figure("imu_sweeps_incomplete", static_cast<double>(sweeps_without_));
}

}  // namespace zloam::driver
