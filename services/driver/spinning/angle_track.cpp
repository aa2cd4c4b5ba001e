#include "driver/spinning/angle_track.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace zloam::driver::spinning {
namespace {

constexpr double kTurn = 2.0 * std::numbers::pi;
// Readings on either side of a time, to which a line is fitted.
constexpr std::size_t kSide = 5;
// A reading is within half a step of the encoder from the angle; the fitted line's own error adds
// to that.
constexpr double kWithinGrains = 0.75;

}  // namespace

void AngleTrack::add(AngleReading reading) {
  ++received_;
  const bool sound = std::isfinite(reading.angle_rad) &&
                     (readings_.empty() || reading.stamp_ns > readings_.back().stamp_ns);
  if (!sound) {
    ++refused_;
    return;
  }
  const double raw_rad = reading.angle_rad;
  if (!readings_.empty()) {
    const double step_rad = raw_rad - last_raw_rad_;
    if (std::abs(step_rad) > kTurn / 2.0) wraps_rad_ -= kTurn * std::round(step_rad / kTurn);
    reading.angle_rad = raw_rad + wraps_rad_;
    const double moved_rad = std::abs(reading.angle_rad - readings_.back().angle_rad);
    constexpr double kNothing = 1e-9;
    if (moved_rad > kNothing && (grain_rad_ == 0.0 || moved_rad < grain_rad_)) {
      grain_rad_ = moved_rad;
    }
  }
  last_raw_rad_ = raw_rad;
  readings_.push_back(reading);
}

bool AngleTrack::reaches(std::int64_t stamp_ns) const {
  if (readings_.empty()) return false;
  // The line fit needs readings after the time as well, except before a gap.
  const auto after =
      std::lower_bound(readings_.begin(), readings_.end(), stamp_ns,
                       [](const AngleReading& r, std::int64_t ns) { return r.stamp_ns < ns; });
  return readings_.end() - after >= static_cast<std::ptrdiff_t>(kSide) ||
         readings_.back().stamp_ns > stamp_ns + kAngleGapNs;
}

/// Fits a line to the readings around a time. It is more precise than any single reading, but valid
/// only if all lie on it within the encoder's step.
std::optional<double> AngleTrack::on_line(std::size_t after, std::int64_t stamp_ns) const {
  if (after < kSide || after + kSide > readings_.size()) return std::nullopt;
  double n = 0.0, st = 0.0, sa = 0.0, stt = 0.0, sta = 0.0;
  for (std::size_t i = after - kSide; i < after + kSide; ++i) {
    if (i > after - kSide && readings_[i].stamp_ns - readings_[i - 1].stamp_ns > kAngleGapNs) {
      return std::nullopt;
    }
    const double t = 1e-9 * static_cast<double>(readings_[i].stamp_ns - stamp_ns);
    n += 1.0;
    st += t;
    sa += readings_[i].angle_rad;
    stt += t * t;
    sta += t * readings_[i].angle_rad;
  }
  const double spread = n * stt - st * st;
  if (!(spread > 0.0)) return std::nullopt;
  const double slope = (n * sta - st * sa) / spread;
  const double here_rad = (sa - slope * st) / n;
  for (std::size_t i = after - kSide; i < after + kSide; ++i) {
    const double t = 1e-9 * static_cast<double>(readings_[i].stamp_ns - stamp_ns);
    const double off_rad = std::abs(readings_[i].angle_rad - here_rad - slope * t);
    if (off_rad > kWithinGrains * grain_rad_) return std::nullopt;
  }
  return here_rad;
}

Angle AngleTrack::at(std::int64_t stamp_ns, double& angle_rad) const {
  if (readings_.empty()) return Angle::kNotYet;
  if (stamp_ns < readings_.front().stamp_ns) return Angle::kMissing;
  const auto after =
      std::lower_bound(readings_.begin(), readings_.end(), stamp_ns,
                       [](const AngleReading& r, std::int64_t ns) { return r.stamp_ns < ns; });
  if (after == readings_.end()) return Angle::kNotYet;
  if (after == readings_.begin()) {
    angle_rad = after->angle_rad;
    return Angle::kKnown;
  }
  const AngleReading& b = *after;
  const AngleReading& a = *(after - 1);
  if (b.stamp_ns - a.stamp_ns > kAngleGapNs) return Angle::kMissing;
  if (const auto smooth = on_line(static_cast<std::size_t>(after - readings_.begin()), stamp_ns)) {
    angle_rad = *smooth;
    return Angle::kKnown;
  }
  const double part =
      static_cast<double>(stamp_ns - a.stamp_ns) / static_cast<double>(b.stamp_ns - a.stamp_ns);
  angle_rad = a.angle_rad + part * (b.angle_rad - a.angle_rad);
  return Angle::kKnown;
}

void AngleTrack::clear() {
  readings_.clear();
  wraps_rad_ = 0.0;
}

void AngleTrack::forget_before(std::int64_t stamp_ns) {
  while (readings_.size() > 4 * kSide && readings_[2 * kSide].stamp_ns < stamp_ns) {
    readings_.pop_front();
  }
}

}  // namespace zloam::driver::spinning
