#pragma once
// Lines of a 2-D scanner on a motor to sweeps of points. Every point is rotated by the motor's
// angle at its own time. Method: J. Zhang, S. Singh, "LOAM: Lidar Odometry and Mapping in
// Real-time", RSS 2014, section IV and the hardware of section VII.

#include <cstdint>
#include <deque>
#include <optional>
#include <string_view>
#include <utility>
#include <vector>

#include "common/geometry/se3.hpp"
#include "driver/scip/client.hpp"
#include "driver/spinning/angle_track.hpp"
#include "driver/spinning/motor_profile.hpp"
#include "driver/spinning/turn_watch.hpp"
#include "driver/sweep/decoded_sweep.hpp"
#include "driver/sweep/mask.hpp"

namespace zloam::driver::spinning {

/// From a scanner's point to the lidar's frame: p = R(axis, direction * (angle - zero)) (T p_S).
/// The axis is fixed to the carrier and goes through the lidar frame's origin.
struct Mount {
  Pose T_motor_scanner = Pose::Identity();
  Eigen::Vector3d axis = Eigen::Vector3d::UnitX();
  double zero_rad = 0.0;
  /// +1 or -1
  double direction = 1.0;
  /// delay of the readings' stamps
  std::int64_t angle_delay_ns = 0;
};

/// Position of an echo in the scanner's plane; nothing for a code or an invalid range.
std::optional<Eigen::Vector3d> in_scanner(const scip::Parameters& scanner, const scip::Echo& echo);
/// Transforms it to the lidar's frame, at an angle of the motor's encoder.
Eigen::Vector3d turned(const Mount& mount, double angle_rad, const Eigen::Vector3d& in_motor);

struct SpinningConfig {
  /// false: the scanner does not rotate, level by zero_rad
  bool turns = true;
  Mount mount;
  /// instead of readings
  std::optional<MotorProfile> profile;
  /// time from one sweep to the next
  double sweep_s = 0.1;
  /// time in which all directions are seen once
  double turn_s = 1.0;
  double min_range_m = 0.0;
  double max_range_m = 1000.0;
  MaskConfig mask;
  ClockSource clock_source = ClockSource::kUnknown;
};

/// A line waits for its angles until lines this much later have come: in a live run, the motor's
/// readings have stopped then.
inline constexpr std::int64_t kAngleLateNs = 1'000'000'000;

class SpinningSweeps {
 public:
  explicit SpinningSweeps(const SpinningConfig& config);

  void add(scip::TimedScan scan, const scip::Parameters& scanner);
  void add(AngleReading reading);
  /// Later readings may have earlier stamps.
  void forget_angles() { track_.clear(); }
  /// The host's clock, by which a motor with a profile runs, is ahead of the lines' time by this.
  void set_host_ahead(std::int64_t ahead_ns) { host_ahead_ns_ = ahead_ns; }
  /// No more lines from before then will come.
  void forget_angles_before(std::int64_t stamp_ns) { track_.forget_before(stamp_ns); }
  bool take(DecodedSweep& sweep);
  /// No more data will come: waiting lines take the angles that are known, the open sweep ends.
  void flush();

  std::vector<std::pair<std::string_view, std::uint64_t>> counts() const;
  /// The motor's measured time, if it differs from turn_s.
  std::optional<double> other_turn_s() const;
  /// The motor has not shown all directions for twice turn_s.
  bool stands() const;
  /// Lines dropped for lack of an angle, in a row until now; see counts().
  std::uint64_t without_angle_in_row() const { return without_angle_in_row_; }

 private:
  /// Of a sweep, in lines and in the scanner's revolutions.
  struct Length {
    std::int64_t lines = 0;
    std::int64_t turns = 0;
  };
  struct Line {
    scip::TimedScan scan;
    scip::Parameters scanner;
    std::int64_t begin_ns = 0;
    std::int64_t end_ns = 0;
    /// by its revolution since the first line
    std::int64_t sweep = 0;
    Length length;

    /// asked for alone (GD, GE), at any time
    bool single() const { return !scan.scan.request.continuous; }
  };

  bool waits_for_readings() const { return config_.turns && !config_.profile; }
  Length length_of(const scip::ScanRequest& request, std::int64_t turn_ns) const;
  void settle(bool ended);
  /// False when an angle is missing within the line.
  bool angles_of(const Line& line);
  void put(const Line& line);
  void put_points(const Line& line);
  void open(const Line& line);
  void close();

  SpinningConfig config_;
  PointMask mask_;
  AngleTrack track_;
  TurnWatch turn_watch_;
  std::int64_t host_ahead_ns_ = 0;
  std::deque<Line> waiting_;
  /// of the line's echoes
  std::vector<double> angles_rad_;
  DecodedSweep sweep_;
  bool open_ = false;
  /// of the open sweep
  std::int64_t sweep_number_ = 0;
  Length length_;
  bool single_ = false;
  /// a line of a continuous measurement has come
  bool measures_ = false;
  /// revolution of the last line received
  std::int64_t turn_ = -1;
  std::uint16_t line_number_ = 0;
  std::deque<DecodedSweep> whole_;
  std::uint64_t lines_ = 0;
  std::uint64_t singles_left_out_ = 0;
  std::uint64_t points_ = 0;
  std::uint64_t masked_ = 0;
  std::uint64_t no_range_ = 0;
  std::uint64_t without_angle_ = 0;
  std::uint64_t without_angle_in_row_ = 0;
};

}  // namespace zloam::driver::spinning
