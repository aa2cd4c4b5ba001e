#include "driver/spinning/sweeps.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace zloam::driver::spinning {
namespace {

// Lines are numbered modulo this; lines near enough to be confused with each other differ.
constexpr std::uint16_t kLineNumbers = 64;
constexpr double kMetresPerMm = 1e-3;
// A sweep's period and the times of its points are 32-bit numbers.
constexpr std::int64_t kMostPeriodNs = std::numeric_limits<std::uint32_t>::max();
// A motor's time that differs by a smaller share makes hardly a difference to the pose.
constexpr double kShare = 0.25;
// A motor that has not shown all directions in this many of its turns stands, or all but stands.
constexpr double kStandsTurns = 2.0;

}  // namespace

std::optional<Eigen::Vector3d> in_scanner(const scip::Parameters& scanner, const scip::Echo& echo) {
  if (echo.range_mm < std::max(1U, scanner.least_mm) || echo.range_mm > scanner.most_mm) return {};
  const double range_m = kMetresPerMm * echo.range_mm;
  const double azimuth_rad = scanner.azimuth_rad(echo.step);
  return Eigen::Vector3d(range_m * std::cos(azimuth_rad), range_m * std::sin(azimuth_rad), 0.0);
}

Eigen::Vector3d turned(const Mount& mount, double angle_rad, const Eigen::Vector3d& in_motor) {
  const double turn_rad = mount.direction * (angle_rad - mount.zero_rad);
  return Eigen::AngleAxisd(turn_rad, mount.axis) * in_motor;
}

SpinningSweeps::SpinningSweeps(const SpinningConfig& config)
    : config_(config), mask_(config.mask) {}

void SpinningSweeps::add(AngleReading reading) {
  reading.stamp_ns -= config_.mount.angle_delay_ns;
  const std::uint64_t refused = track_.refused();
  track_.add(reading);
  if (track_.refused() == refused) turn_watch_.add(track_.last());
  settle(false);
}

SpinningSweeps::Length SpinningSweeps::length_of(const scip::ScanRequest& request,
                                                 std::int64_t turn_ns) const {
  const std::int64_t line_ns = turn_ns * (1 + request.skipped);
  const std::int64_t lines =
      std::clamp<std::int64_t>(std::llround(1e9 * config_.sweep_s / static_cast<double>(line_ns)),
                               1, std::max<std::int64_t>(1, kMostPeriodNs / line_ns));
  return {lines, lines * (1 + request.skipped)};
}

void SpinningSweeps::add(scip::TimedScan scan, const scip::Parameters& scanner) {
  const scip::ScanRequest& request = scan.scan.request;
  turn_ += scan.turns;
  ++lines_;
  measures_ = measures_ || request.continuous;
  // A single scan repeats a revolution that is measured anyway.
  if (measures_ && !request.continuous) {
    ++singles_left_out_;
    return;
  }
  Line line;
  line.begin_ns = scan.stamp_ns + scanner.step_ns(request.first_step);
  line.end_ns = scan.stamp_ns + scanner.step_ns(request.last_step);
  line.length = length_of(request, scanner.turn_ns());
  line.sweep = turn_ / line.length.turns;
  line.scanner = scanner;
  line.scan = std::move(scan);
  waiting_.push_back(std::move(line));
  settle(false);
}

/// Puts the waiting lines, in order, into sweeps, as far as their angles are known or missing.
void SpinningSweeps::settle(bool ended) {
  while (!waiting_.empty()) {
    const Line& line = waiting_.front();
    const bool late = waiting_.back().end_ns - line.end_ns > kAngleLateNs;
    if (waits_for_readings() && !ended && !late && !track_.reaches(line.end_ns)) return;
    if (angles_of(line)) {
      without_angle_in_row_ = 0;
      put(line);
    } else {
      ++without_angle_;
      ++without_angle_in_row_;
    }
    track_.forget_before(line.begin_ns);
    waiting_.pop_front();
  }
}

bool SpinningSweeps::angles_of(const Line& line) {
  const std::vector<scip::Echo>& echoes = line.scan.scan.echoes;
  angles_rad_.assign(echoes.size(), 0.0);
  if (!config_.turns) return true;
  for (std::size_t i = 0; i < echoes.size(); ++i) {
    const std::int64_t at_ns = line.scan.stamp_ns + line.scanner.step_ns(echoes[i].step);
    if (config_.profile) {
      angles_rad_[i] =
          config_.profile->angle_rad(at_ns + config_.mount.angle_delay_ns + host_ahead_ns_);
    } else if (track_.at(at_ns, angles_rad_[i]) != Angle::kKnown) {
      return false;
    }
  }
  return true;
}

void SpinningSweeps::put(const Line& line) {
  const bool same =
      line.sweep == sweep_number_ && line.length.turns == length_.turns && line.single() == single_;
  if (open_ && !same) close();
  if (!open_) open(line);
  put_points(line);
  sweep_.packets += 1;
  sweep_.last_packet_ns = line.scan.scan.received_ns;
  line_number_ = static_cast<std::uint16_t>((line_number_ + 1) % kLineNumbers);
  // Of single scans any number may fall into a sweep's time.
  if (!single_ && sweep_.packets == length_.lines) close();
}

void SpinningSweeps::open(const Line& line) {
  sweep_ = {};
  sweep_number_ = line.sweep;
  length_ = line.length;
  single_ = line.single();
  sweep_.stamp_ns = line.begin_ns;
  sweep_.period_ns = static_cast<std::uint32_t>(length_.turns * line.scanner.turn_ns());
  sweep_.rings = kLineNumbers;
  sweep_.slices = static_cast<std::uint16_t>(
      std::max(1L, std::lround(1e9 * config_.turn_s / sweep_.period_ns)));
  sweep_.model = line.scanner.model;
  sweep_.return_mode = ReturnMode::kStrongest;
  sweep_.clock_source = config_.clock_source;
  open_ = true;
}

void SpinningSweeps::put_points(const Line& line) {
  const Mount& mount = config_.mount;
  const std::vector<scip::Echo>& echoes = line.scan.scan.echoes;
  for (std::size_t i = 0; i < echoes.size(); ++i) {
    const scip::Echo& echo = echoes[i];
    const std::optional<Eigen::Vector3d> p_scanner = in_scanner(line.scanner, echo);
    if (!p_scanner) {
      ++no_range_;
      continue;
    }
    const double range_m = kMetresPerMm * echo.range_mm;
    if (range_m < config_.min_range_m || range_m > config_.max_range_m) {
      ++masked_;
      continue;
    }
    const Eigen::Vector3d p = turned(mount, angles_rad_[i], mount.T_motor_scanner * *p_scanner);
    const std::int64_t at_ns = line.scan.stamp_ns + line.scanner.step_ns(echo.step);
    const Point point{static_cast<float>(p.x()),
                      static_cast<float>(p.y()),
                      static_cast<float>(p.z()),
                      static_cast<float>(echo.intensity),
                      static_cast<std::uint32_t>(at_ns - sweep_.stamp_ns),
                      line_number_,
                      echo.number == 0 ? ReturnType::kStrongest : ReturnType::kLast,
                      0};
    if (mask_.active() && !mask_.keeps(point)) {
      ++masked_;
      continue;
    }
    sweep_.points.push_back(point);
    sweep_.columns.push_back(line_number_);
    ++points_;
  }
}

void SpinningSweeps::close() {
  if (!open_) return;
  // The number of single scans is not known in advance: none is missing, and no sweep is complete.
  const auto wanted = single_ ? 0U : static_cast<std::uint32_t>(length_.lines);
  sweep_.packets_lost = wanted - std::min(wanted, sweep_.packets);
  sweep_.complete = !single_ && sweep_.packets_lost == 0;
  open_ = false;
  whole_.push_back(std::exchange(sweep_, {}));
}

std::optional<double> SpinningSweeps::other_turn_s() const {
  const std::optional<double> measured = turn_watch_.turn_s();
  if (!measured || std::abs(*measured - config_.turn_s) < kShare * config_.turn_s) return {};
  return measured;
}

bool SpinningSweeps::stands() const {
  return waits_for_readings() && turn_watch_.open_s() > kStandsTurns * config_.turn_s;
}

void SpinningSweeps::flush() {
  settle(true);
  close();
}

bool SpinningSweeps::take(DecodedSweep& sweep) {
  if (whole_.empty()) return false;
  sweep = std::move(whole_.front());
  whole_.pop_front();
  return true;
}

std::vector<std::pair<std::string_view, std::uint64_t>> SpinningSweeps::counts() const {
  return {{"lines", lines_},
          {"single_scans_left_out", singles_left_out_},
          {"points", points_},
          {"points_masked", masked_},
          {"steps_without_range", no_range_},
          {"lines_without_angle", without_angle_},
          {"angles_received", track_.received()},
          {"angles_refused", track_.refused()}};
}

}  // namespace zloam::driver::spinning
