#include "driver/spinning/turn_watch.hpp"

#include <cmath>
#include <numbers>
#include <numeric>
#include <utility>

namespace zloam::driver::spinning {
namespace {

// A step back by more than this is a reversal, not jitter or resolution of the encoder.
constexpr double kReversal_rad = 0.035;
constexpr std::size_t kEnoughTurns = 3;

}  // namespace

void TurnWatch::end(std::int64_t stamp_ns, double angle_rad) {
  if (whole_) {
    turns_s_.push_back(1e-9 * static_cast<double>(stamp_ns - from_ns_));
    if (turns_s_.size() > kEnoughTurns) turns_s_.pop_front();
  }
  whole_ = true;
  from_ns_ = farthest_ns_ = stamp_ns;
  from_rad_ = farthest_rad_ = angle_rad;
}

void TurnWatch::begin(const AngleReading& reading) {
  begun_ = true;
  whole_ = false;
  way_ = 0.0;
  from_ns_ = farthest_ns_ = reading.stamp_ns;
  from_rad_ = farthest_rad_ = reading.angle_rad;
}

void TurnWatch::add(const AngleReading& reading) {
  const std::int64_t apart_ns = reading.stamp_ns - std::exchange(last_ns_, reading.stamp_ns);
  if (!begun_ || apart_ns <= 0 || apart_ns > kAngleGapNs) return begin(reading);
  const double moved_rad = reading.angle_rad - from_rad_;
  if (way_ == 0.0) {
    if (std::abs(moved_rad) < kReversal_rad) return;
    way_ = moved_rad > 0.0 ? 1.0 : -1.0;
  }
  if (way_ * (reading.angle_rad - farthest_rad_) > 0.0) {
    farthest_rad_ = reading.angle_rad;
    farthest_ns_ = reading.stamp_ns;
  } else if (way_ * (farthest_rad_ - reading.angle_rad) > kReversal_rad) {
    end(farthest_ns_, farthest_rad_);
    way_ = -way_;
  }
  // The margin lets a swing of exactly half a revolution end at its reversal.
  const double turned_rad = way_ * (reading.angle_rad - from_rad_);
  if (turned_rad < std::numbers::pi + 2.0 * kReversal_rad) return;
  const double part = std::numbers::pi / turned_rad;
  end(from_ns_ + std::llround(part * static_cast<double>(reading.stamp_ns - from_ns_)),
      from_rad_ + way_ * std::numbers::pi);
}

std::optional<double> TurnWatch::turn_s() const {
  if (turns_s_.size() < kEnoughTurns) return std::nullopt;
  return std::accumulate(turns_s_.begin(), turns_s_.end(), 0.0) / kEnoughTurns;
}

double TurnWatch::open_s() const { return 1e-9 * static_cast<double>(last_ns_ - from_ns_); }

}  // namespace zloam::driver::spinning
