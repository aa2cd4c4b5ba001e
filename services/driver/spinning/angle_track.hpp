#pragma once
// The angle of a motor between the readings of its encoder.

#include <cstdint>
#include <deque>
#include <optional>

namespace zloam::driver::spinning {

/// One reading; unwrapped, or wrapped to a revolution.
struct AngleReading {
  std::int64_t stamp_ns = 0;
  double angle_rad = 0.0;
};

/// No angle is known within a longer gap between readings.
inline constexpr std::int64_t kAngleGapNs = 50'000'000;

enum class Angle : std::uint8_t { kKnown, kNotYet, kMissing };

class AngleTrack {
 public:
  /// Takes readings in order; one that is not later than the last, or not finite, is counted and
  /// dropped. A step of more than half a revolution is the encoder's own wrap.
  void add(AngleReading reading);

  /// kNotYet: the readings do not reach the time yet. kMissing: it lies before the first reading or
  /// in a gap of more than 50 ms.
  Angle at(std::int64_t stamp_ns, double& angle_rad) const;
  /// Whether all angles up to then are known or missing.
  bool reaches(std::int64_t stamp_ns) const;
  /// Drops all readings.
  void clear();
  /// Drops readings before then.
  void forget_before(std::int64_t stamp_ns);

  /// The earliest reading kept and the last one accepted, unwrapped.
  const AngleReading& first() const { return readings_.front(); }
  const AngleReading& last() const { return readings_.back(); }
  std::uint64_t received() const { return received_; }
  std::uint64_t refused() const { return refused_; }

 private:
  std::optional<double> on_line(std::size_t after, std::int64_t stamp_ns) const;

  std::deque<AngleReading> readings_;
  /// the encoder's least step
  double grain_rad_ = 0.0;
  double last_raw_rad_ = 0.0;
  double wraps_rad_ = 0.0;
  std::uint64_t received_ = 0;
  std::uint64_t refused_ = 0;
};

}  // namespace zloam::driver::spinning
