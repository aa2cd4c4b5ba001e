#include "driver/io/scip_source.hpp"

#include <algorithm>
#include <array>
#include <chrono>
#include <cstdio>
#include <filesystem>
#include <stdexcept>
#include <thread>
#include <utility>

#include "driver/io/metadata_file.hpp"
#include "driver/io/scip_link.hpp"
#include "driver/io/stamped_table.hpp"
#include "driver/spinning/host_steps.hpp"
#include "driver/spinning/mount_file.hpp"

namespace zloam::driver {
namespace {

constexpr std::int64_t kFirstPauseNs = 250'000'000;
constexpr std::int64_t kLongestPauseNs = 4'000'000'000;
// A line this late is useless, so older angles can be dropped.
constexpr std::int64_t kKeptAnglesNs = 10'000'000'000;
// Whoever looks each second must see a connection that was lost for a moment.
constexpr std::int64_t kToldNs = 2'000'000'000;
// If the angles' stamps go back by more than this, the angles start again.
constexpr std::int64_t kRestartNs = 1'000'000'000;
// Two clocks that were read within this time were read together.
constexpr std::int64_t kReadTogetherNs = 100'000;
// Lines without an angle in a row before it is reported: one second of them.
constexpr std::uint64_t kSaidAfterLines = 40;

constexpr const char* kStands =
    "the motor has not shown all directions in twice the motor.turn_s of the file in "
    "driver.metadata: does it turn? From one plane no motion in three dimensions can be found";

std::int64_t steady_ns() {
  return std::chrono::nanoseconds(std::chrono::steady_clock::now().time_since_epoch()).count();
}

std::filesystem::path angles_path(const std::string& session) {
  return std::filesystem::path(session).replace_extension(".csv");
}

/// Common part of live and recorded scanners: bytes to scans to sweeps.
class ScannerSweeps : public ScipSource {
 public:
  explicit ScannerSweeps(const ScipSourceConfig& config)
      : client_(config.client), sweeps_(config.spinning), live_(config.client.asks) {}

  void add(const spinning::AngleReading& reading) override {
    sweeps_.add(reading);
    watch_motor();
  }
  void record(bool on) override { recorded_.record(on); }
  std::vector<RawPacket> take_packets() override { return recorded_.take(); }

  NamedCounts counts() const override {
    NamedCounts all = {{"packets_received", chunks_},
                       {"reconnects", reconnects_},
                       {"packets_not_recorded", recorded_.left_out()}};
    for (const auto& count : client_.counts()) all.push_back(count);
    for (const auto& count : sweeps_.counts()) all.push_back(count);
    return all;
  }

  std::vector<std::string> troubles() const override {
    std::vector<std::string> all;
    if (sweeps_.without_angle_in_row() >= kSaidAfterLines) all.push_back(no_angles_text(live_));
    if (!motor_trouble_.empty()) all.push_back(motor_trouble_);
    return all;
  }

  std::vector<std::string> remarks() const override {
    std::vector<std::string> all = client_.remarks();
    all.insert(all.end(), remarks_.begin(), remarks_.end());
    return all;
  }

 protected:
  void take_bytes(const std::vector<std::uint8_t>& bytes, std::int64_t received_ns) {
    ++chunks_;
    recorded_.add(bytes, received_ns, 0);
    client_.add(bytes, received_ns);
    pass_on();
  }

  void pass_on() {
    while (auto scan = client_.take_scan()) sweeps_.add(std::move(*scan), *client_.parameters());
    was_without_angles_ = was_without_angles_ || sweeps_.without_angle_in_row() >= kSaidAfterLines;
  }

  /// A trouble keeps its text until it ends, whatever is measured meanwhile.
  void watch_motor() {
    const std::optional<double> turn_s = sweeps_.other_turn_s();
    const bool stands = sweeps_.stands();
    if (!turn_s && !stands) motor_trouble_.clear();
    if ((!turn_s && !stands) || !motor_trouble_.empty()) return;
    std::array<char, 200> text{};
    std::snprintf(text.data(), text.size(),
                  "the motor shows all directions in %.2f s, which is not motor.turn_s of the file "
                  "in driver.metadata: the pose depends on it",
                  turn_s.value_or(0.0));
    motor_trouble_ = stands ? kStands : text.data();
    if (motor_was_.empty()) motor_was_ = motor_trouble_;
  }

  void say(const std::string& text) {
    if (std::find(remarks_.begin(), remarks_.end(), text) == remarks_.end()) {
      remarks_.push_back(text);
    }
  }

  scip::Client client_;
  spinning::SpinningSweeps sweeps_;
  std::uint64_t reconnects_ = 0;
  bool was_without_angles_ = false;
  /// what is wrong with the motor's motion, and what was first
  std::string motor_trouble_, motor_was_;

 private:
  bool live_;
  PacketsForRecorder recorded_;
  std::uint64_t chunks_ = 0;
  std::vector<std::string> remarks_;
};

class LiveScanner : public ScannerSweeps {
 public:
  LiveScanner(std::string device, const ScipSourceConfig& config, int timeout_ms)
      : ScannerSweeps(config), device_(std::move(device)), timeout_ms_(timeout_ms) {
    link_ = open_scip_device(device_);
    client_.connected(even_ns());
  }

  Pull pull(DecodedSweep& sweep) override {
    look_at_clock();
    if (take(sweep)) return Pull::kSweep;
    if (!link_ && !reconnected()) return Pull::kNothing;
    send();
    std::int64_t received_ns = 0;
    switch (link_->read(bytes_, received_ns, timeout_ms_)) {
      case ScipLink::Read::kBytes:
        pause_ns_ = kFirstPauseNs;
        take_bytes(bytes_, received_ns);
        break;
      case ScipLink::Read::kNothing:
        break;
      case ScipLink::Read::kClosed:
        lost(device_ + ": " + link_->why());
        return Pull::kNothing;
    }
    client_.look(even_ns());
    if (!client_.refusal().empty()) throw SourceError(device_ + ": " + client_.refusal());
    send();
    has_measured_ = has_measured_ || client_.measuring();
    if (client_.take_reconnect()) lost(device_ + ": the scanner is silent");
    return take(sweep) ? Pull::kSweep : Pull::kNothing;
  }

  void add(const spinning::AngleReading& reading) override {
    look_at_clock();
    const std::int64_t stamp_ns = host_steps_.even_ns(reading.stamp_ns, even_ns());
    // One reading from far ahead, or a motor's program with another clock: the readings start
    // again.
    if (stamp_ns < newest_angle_ns_ - kRestartNs) sweeps_.forget_angles();
    newest_angle_ns_ = stamp_ns;
    ScannerSweeps::add({stamp_ns, reading.angle_rad});
    sweeps_.forget_angles_before(stamp_ns - kKeptAnglesNs);
  }

  NamedCounts counts() const override {
    NamedCounts all = ScannerSweeps::counts();
    all.emplace_back("host_clock_steps", host_steps_.count());
    return all;
  }

  std::vector<std::string> troubles() const override {
    std::vector<std::string> all = ScannerSweeps::troubles();
    if (!link_ || steady_ns() < told_until_ns_) all.push_back(lost_why_);
    return all;
  }

  void flush() override { sweeps_.flush(); }

 private:
  void look_at_clock() {
    const std::int64_t before_ns = even_ns();
    const std::int64_t host_ns = wall_ns();
    const std::int64_t took_ns = even_ns() - before_ns;
    // Interrupted between the readings of both clocks: the next look tells.
    if (took_ns > kReadTogetherNs) return;
    host_steps_.look(host_ns - before_ns - took_ns / 2, before_ns);
    sweeps_.set_host_ahead(host_steps_.ahead_ns());
  }

  /// A sweep tells of a step, and when its last bytes came by the clock of those who read it.
  bool take(DecodedSweep& sweep) {
    if (!sweeps_.take(sweep)) return false;
    sweep.host_clock_step_ns += host_steps_.take_step_ns();
    sweep.last_packet_ns += host_steps_.ahead_ns();
    return true;
  }

  void send() {
    if (const std::string output = client_.take_output(); !output.empty()) link_->write(output);
  }

  void lost(const std::string& why) {
    lost_why_ = why + ": connecting again";
    link_.reset();
    again_ns_ = steady_ns() + pause_ns_;
    pause_ns_ = std::min(2 * pause_ns_, kLongestPauseNs);
  }

  bool reconnected() {
    if (steady_ns() < again_ns_) {
      std::this_thread::sleep_for(std::chrono::milliseconds(timeout_ms_));
      return false;
    }
    try {
      link_ = open_scip_device(device_, !has_measured_);
    } catch (const SourceError& error) {
      lost(error.what());
      return false;
    }
    ++reconnects_;
    has_measured_ = false;
    told_until_ns_ = steady_ns() + kToldNs;
    client_.connected(even_ns());
    return true;
  }

  std::string device_;
  int timeout_ms_;
  std::unique_ptr<ScipLink> link_;
  std::vector<std::uint8_t> bytes_;
  /// since it was connected
  bool has_measured_ = false;
  std::int64_t pause_ns_ = kFirstPauseNs;
  std::int64_t again_ns_ = 0;
  /// why the last connection was lost, and until when that is a trouble
  std::string lost_why_;
  std::int64_t told_until_ns_ = 0;
  std::int64_t newest_angle_ns_ = 0;
  spinning::HostSteps host_steps_;
};

class RecordedScanner : public ScannerSweeps {
 public:
  RecordedScanner(const std::string& path, const std::vector<spinning::AngleReading>& angles,
                  const ScipSourceConfig& config)
      : ScannerSweeps(passive(config)), path_(path), link_(open_scip_session(path)) {
    for (const spinning::AngleReading& reading : angles) add(reading);
    client_.connected(0);
  }

  Pull pull(DecodedSweep& sweep) override {
    std::int64_t received_ns = 0;
    while (!sweeps_.take(sweep)) {
      if (ended_) return Pull::kEnd;
      if (link_->read(bytes_, received_ns, 0) == ScipLink::Read::kBytes) {
        take_bytes(bytes_, received_ns);
      } else {
        end();
      }
    }
    return Pull::kSweep;
  }

 private:
  static ScipSourceConfig passive(ScipSourceConfig config) {
    config.client.asks = false;
    return config;
  }

  void end() {
    ended_ = true;
    if (!link_->why().empty()) say(link_->why());
    if (!client_.parameters()) {
      say(path_ + ": holds no reply to PP, without which no scan can be used");
    }
    client_.flush();
    pass_on();
    sweeps_.flush();
    if (was_without_angles_) say(no_angles_text(false));
    if (!motor_was_.empty()) say(motor_was_);
  }

  std::string path_;
  std::unique_ptr<ScipLink> link_;
  std::vector<std::uint8_t> bytes_;
  bool ended_ = false;
};

}  // namespace

ScipSourceConfig read_mount_file(const std::string& path) {
  ScipSourceConfig config;
  if (path.empty()) return config;
  try {
    spinning::read_mount(text_of_metadata(path), config.client, config.spinning);
  } catch (const std::invalid_argument& error) {
    throw SourceError(path + ": " + error.what());
  }
  return config;
}

std::unique_ptr<ScipSource> sweeps_of_scanner(const std::string& device,
                                              const ScipSourceConfig& config, int timeout_ms) {
  return std::make_unique<LiveScanner>(device, config, timeout_ms);
}

std::unique_ptr<ScipSource> sweeps_of_session(const std::string& path,
                                              const std::vector<spinning::AngleReading>& angles,
                                              const ScipSourceConfig& config) {
  return std::make_unique<RecordedScanner>(path, angles, config);
}

std::unique_ptr<ScipSource> sweeps_of_session(const std::string& path, ScipSourceConfig config) {
  const std::filesystem::path angles = angles_path(path);
  const bool has_profile = config.spinning.profile.has_value();
  config.spinning.turns = has_profile || std::filesystem::exists(angles);
  std::vector<spinning::AngleReading> readings;
  if (config.spinning.turns && !has_profile) readings = read_angle_file(angles.string());
  return sweeps_of_session(path, readings, config);
}

std::string no_angles_text(bool live) {
  const auto ms = [](std::int64_t ns) { return std::to_string(ns / 1'000'000) + " ms"; };
  std::string text =
      "lines come, but no angle of the motor for their times: readings may be at most ";
  text += ms(spinning::kAngleGapNs) + " apart";
  if (!live) return text + ". Does their table cover the session, and by the same clock?";
  return text + ", and a line waits " + ms(spinning::kAngleLateNs) +
         " for them. Are they published (lidar/<sensor>/angle), and by the same clock?";
}

std::string angles_beside(const std::string& session) {
  const std::filesystem::path path = angles_path(session);
  if (std::filesystem::is_regular_file(path)) return path.string();
  throw SourceError(session +
                    ": the motor's angles are missing, a table with t_ns and angle_rad in " +
                    path.string() +
                    ", or motor.profile in the file in driver.metadata: a scanner that stands "
                    "still sees one plane, in which no motion in three "
                    "dimensions can be found");
}

std::vector<spinning::AngleReading> read_angle_file(const std::string& path) {
  std::vector<spinning::AngleReading> readings;
  for (const StampedRow& row : read_stamped_table(path, {"t_ns", "angle_rad"})) {
    readings.push_back({row.stamp_ns, row.values.front()});
  }
  if (readings.empty()) throw SourceError(path + ": holds no reading");
  return readings;
}

}  // namespace zloam::driver
