#pragma once
// Time in which a motor shows a scanner all directions once: from one reversal to the next, or for
// half a revolution.

#include <cstdint>
#include <deque>
#include <optional>

#include "driver/spinning/angle_track.hpp"

namespace zloam::driver::spinning {

class TurnWatch {
 public:
  /// Takes unwrapped readings. After a gap, or a stamp that goes back, the present time is dropped.
  void add(const AngleReading& reading);
  /// The mean of the last three complete times, s; nothing before the third.
  std::optional<double> turn_s() const;
  /// From the begin of the present time to the last reading, s.
  double open_s() const;

 private:
  void begin(const AngleReading& reading);
  void end(std::int64_t stamp_ns, double angle_rad);

  bool begun_ = false;
  std::int64_t last_ns_ = 0;
  std::int64_t from_ns_ = 0;
  double from_rad_ = 0.0;
  /// the farthest angle of the present swing or half revolution, and its time
  double farthest_rad_ = 0.0;
  std::int64_t farthest_ns_ = 0;
  double way_ = 0.0;  ///< +1, -1; 0: not known yet
  /// false: the first swing started before the readings
  bool whole_ = false;
  std::deque<double> turns_s_;
};

}  // namespace zloam::driver::spinning
