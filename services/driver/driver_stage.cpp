#include "driver/driver_stage.hpp"

#include <algorithm>
#include <array>
#include <chrono>
#include <cstdio>
#include <filesystem>
#include <thread>

#include "common/runtime/fault.hpp"
#include "driver/io/message_fields.hpp"
#include "driver/io/metadata_file.hpp"
#include "driver/io/recorded_source.hpp"
#include "schemas/angle_generated.h"
#include "schemas/packets_generated.h"

namespace zloam::driver {
namespace {

using runtime::Poll;

// Longest wait on the socket, and so the longest delay of a command.
constexpr int kSocketWaitMs = 5;
// After this silence an unfinished sweep is published: across a longer gap no motion estimate is
// credible. Packets that are merely late, over a radio link or from a busy host, still join their
// sweep.
constexpr std::int64_t kFlushAfterNs = 1'000'000'000;
// Every sensor gives several sweeps in this time; the first one of a scanner takes longest.
constexpr double kNoSweepSeconds = 3.0;
constexpr int kProgressSeconds = 5;
// How long the health status reports that a clock was set.
constexpr int kStepSaidSeconds = 10;
// How long a live sweep waits for IMU readings.
constexpr std::int64_t kImuWaitNs = 20'000'000;

/// Used for waiting and pacing, as the host's clock may be set meanwhile.
std::int64_t steady_ns() {
  return std::chrono::nanoseconds(std::chrono::steady_clock::now().time_since_epoch()).count();
}

}  // namespace

DriverStage::DriverStage(runtime::Stage& stage, const DriverConfig& config)
    : stage_(stage),
      config_(config),
      sweeps_(stage.outlet(Key::kSweep)),
      packets_(stage.outlet(Key::kPackets)),
      gnss_(stage.outlet(Key::kGnss)),
      window_(stage.flow_window(sweeps_)),
      rate_(rate_factor(config.rate)) {
  try {
    imu_.emplace(stage_, config_);
    if (config_.source == SourceKind::kUdp) {
      open_udp_source();
    } else if (config_.source == SourceKind::kZenoh) {
      open_zenoh();
    } else if (config_.source == SourceKind::kScip) {
      open_scanner();
    } else {
      open_finite();
    }
  } catch (const SourceError& error) {
    throw runtime::IoError(error.what());
  }
  say_remarks();
  last_datagram_ns_ = no_sweep_since_ns_ = steady_ns();
  stage_.every(std::chrono::seconds(1), [this] { every_second(); });
  stage_.on_poll([this] { return window_.replay() ? poll_replay() : poll_live(); });
  stage_.ready(true, "");
}

void DriverStage::open_udp_source() {
  PacketStreamConfig stream = packet_stream_config(config_, stage_.shared());
  read_metadata(config_.metadata, "", stream.decoding);
  UdpOptions udp = config_.udp;
  udp.sender = stream.sender;
  udp.clock_ahead_ns = runtime::clock_fault_ns();
  source_ = sweeps_of_packets(open_udp(udp), stream, kSocketWaitMs);
  window_.start_live();
}

void DriverStage::open_zenoh() {
  PacketStreamConfig stream = packet_stream_config(config_, stage_.shared());
  read_metadata(config_.metadata, "", stream.decoding);
  stream_ = std::make_unique<PacketStream>(stream);
  runtime::InletOptions options;
  options.ends_run = false;
  stage_.inlet<msg::Packets>(
      Key::kPackets, options,
      [this](const runtime::Received<msg::Packets>& packets) { on_packets(packets); });
  window_.start_live();
}

void DriverStage::open_scanner() {
  const ScipSourceConfig config =
      scip_source_config(config_, stage_.shared().mounting.T_base_lidar());
  auto scanner = sweeps_of_scanner(config_.path, config, kSocketWaitMs);
  ScipSource& turned = *scanner;
  source_ = std::move(scanner);
  if (!config.spinning.profile) hear_angles(turned);
  window_.start_live();
}

void DriverStage::hear_angles(ScipSource& turned) {
  runtime::InletOptions options;
  options.order = runtime::Order::kAsTheyCome;
  options.lossless = true;
  options.outside_runs = true;
  stage_.inlet<msg::MotorAngles>(Key::kAngle, options,
                                 [&turned](const runtime::Received<msg::MotorAngles>& angles) {
                                   if (angles->readings() == nullptr) return;
                                   for (const msg::AngleReading* reading : *angles->readings()) {
                                     turned.add({reading->stamp_ns(), reading->angle_rad()});
                                   }
                                 });
}

void DriverStage::open_finite() {
  RecordedSource recorded = open_recorded(config_, stage_.shared());
  source_ = std::move(recorded.sweeps);
  if (!fetch()) {
    std::string text = config_.path + ": gives no sweep; seen: " + counted(counts());
    for (const std::string& remark : source_->remarks()) text += "; " + remark;
    throw SourceError(text);
  }
  first_stamp_ns_ = current_->sweep.stamp_ns;
  imu_->check_time_of(first_stamp_ns_);
  std::vector<std::string>& files = recorded.files;
  if (config_.imu == ImuChoice::kFile) files.push_back(config_.imu_path);
  window_.start_replay(recorded.identity + (files.empty() ? "" : hash_of_files(files)));
}

/// Advances to the next sweep; false at the end.
bool DriverStage::fetch() {
  const auto pull = [this](std::optional<Outgoing>& into) {
    source_->record(packets_.matching());
    Outgoing outgoing;
    if (source_->pull(outgoing.sweep) != Pull::kSweep) {
      source_ended_ = true;
      imu_->add(source_->take_imu());
      return;
    }
    outgoing.packets = source_->take_packets();
    imu_->add(source_->take_imu());
    into = std::move(outgoing);
  };
  if (!current_ && !next_ && !source_ended_) pull(next_);
  current_ = std::move(next_);
  next_.reset();
  if (!source_ended_) pull(next_);
  return current_.has_value();
}

Poll DriverStage::poll_replay() {
  if (last_published_) return finish_replay();
  if (!window_.begun()) return Poll::kWait;
  if (pace_start_ns_ == 0) pace_start_ns_ = steady_ns();
  if (number_ >= window_.resume_at()) {
    if (!window_.may_send(number_)) return Poll::kWait;
    if (!due()) return Poll::kAgain;
    publish(*current_, !next_);
  }
  publish_positions();
  ++number_;
  try {
    if (!fetch()) last_published_ = true;
  } catch (const SourceError& error) {
    stage_.fail(error.what());
    return Poll::kWait;
  }
  return Poll::kAgain;
}

Poll DriverStage::finish_replay() {
  if (!window_.finished()) return Poll::kWait;
  say_remarks();
  say_counts();
  runtime::log_info("the replay is finished", {{"sweeps", number_}});
  stage_.stop();
  return Poll::kWait;
}

/// Whether the end of the sweep is due in a paced replay. Waits a little if it is not.
bool DriverStage::due() {
  if (!rate_) return true;
  const DecodedSweep& sweep = current_->sweep;
  const std::int64_t end_ns = sweep.stamp_ns + sweep.period_ns;
  const auto due_ns = pace_start_ns_ + static_cast<std::int64_t>(
                                           static_cast<double>(end_ns - first_stamp_ns_) / *rate_);
  const std::int64_t left_ns = due_ns - steady_ns();
  if (left_ns <= 0) return true;
  std::this_thread::sleep_for(std::min<std::chrono::nanoseconds>(
      std::chrono::nanoseconds(left_ns), std::chrono::milliseconds(kSocketWaitMs)));
  return false;
}

bool DriverStage::pull_live(Outgoing& outgoing) {
  // Packets that come over Zenoh are on the key already.
  if (!source_) return stream_->take(outgoing.sweep);
  source_->record(packets_.matching());
  const bool came = source_->pull(outgoing.sweep) == Pull::kSweep;
  if (came) outgoing.packets = source_->take_packets();
  return came;
}

void DriverStage::publish_waiting() {
  if (!waiting_) return;
  const DecodedSweep& sweep = waiting_->sweep;
  const bool late = steady_ns() - waiting_since_ns_ > kImuWaitNs;
  if (!late && imu_->lacks(sweep.stamp_ns + sweep.period_ns)) return;
  publish(*waiting_, false);
  ++number_;
  waiting_.reset();
}

Poll DriverStage::poll_live() {
  Outgoing outgoing;
  bool came = false;
  try {
    came = pull_live(outgoing);
  } catch (const SourceError& error) {
    stage_.fail(error.what());
    return Poll::kWait;
  }
  imu_->add(source_ ? source_->take_imu() : stream_->take_imu());
  if (came) {
    // A sweep that still waits for IMU readings when the next one is complete is published without
    // them.
    if (waiting_) waiting_since_ns_ = 0;
    publish_waiting();
    waiting_ = std::move(outgoing);
    waiting_since_ns_ = steady_ns();
  }
  publish_waiting();
  publish_positions();
  watch_quiet(came);
  watch_sweeps(came);
  if (waiting_ && !source_) std::this_thread::sleep_for(std::chrono::milliseconds(1));
  return came || source_ || waiting_ ? Poll::kAgain : Poll::kWait;
}

void DriverStage::on_packets(const runtime::Received<msg::Packets>& packets) {
  if (packets->entries() == nullptr || packets->data() == nullptr) return;
  const std::span<const std::uint8_t> data(packets->data()->data(), packets->data()->size());
  for (const msg::PacketEntry* entry : *packets->entries()) {
    if (entry->offset() > data.size() || entry->length() > data.size() - entry->offset()) continue;
    stream_->add(
        {data.subspan(entry->offset(), entry->length()), entry->received_ns(), entry->port(), 0});
  }
  if (packets.end_of_run()) stream_->flush();
}

void DriverStage::publish(const Outgoing& outgoing, bool last) {
  const DecodedSweep& sweep = outgoing.sweep;
  const std::int64_t now_ns = stage_.now_ns();
  HeaderFields header = sweeps_.header(now_ns, now_ns);
  header.run = window_.run();
  header.sweep = number_;
  header.stamp_ns = sweep.stamp_ns;
  header.frame = "lidar";
  header.end_of_run = last;
  header.replay = window_.replay();
  // In a paced replay, publishing counts as the sweep's arrival.
  header.last_packet_ns = !window_.replay() ? sweep.last_packet_ns : rate_ ? now_ns : 0;
  if (!window_.replay() && sweep.last_packet_ns != 0) {
    stage_.latency("last_packet_to_publish",
                   1e-6 * static_cast<double>(now_ns - sweep.last_packet_ns));
  }
  SweepFields fields = fields_of(sweep);
  fields.imu = imu_->over(sweep.stamp_ns, sweep.stamp_ns + sweep.period_ns);
  fields.imu_incomplete = imu_->incomplete();
  sweeps_.publish(header, build(header, fields));
  report_steps(sweep);
  if (!outgoing.packets.empty()) publish_packets(outgoing);
}

void DriverStage::publish_packets(const Outgoing& outgoing) {
  std::vector<msg::PacketEntry> entries;
  std::vector<std::uint8_t> data;
  for (const RawPacket& packet : outgoing.packets) {
    entries.emplace_back(packet.received_ns, static_cast<std::uint32_t>(data.size()),
                         static_cast<std::uint16_t>(packet.payload.size()), packet.port);
    data.insert(data.end(), packet.payload.begin(), packet.payload.end());
  }
  const std::int64_t now_ns = stage_.now_ns();
  HeaderFields header = packets_.header(now_ns, now_ns);
  header.run = window_.run();
  header.sweep = number_;
  header.stamp_ns = outgoing.sweep.stamp_ns;
  header.replay = window_.replay();
  packets_.publish(header, build(header, PacketsFields{entries, data, outgoing.sweep.model}));
}

void DriverStage::publish_positions() {
  std::vector<GnssFixFields> fixes;
  for (const ReceivedPosition& position :
       source_ ? source_->take_positions() : stream_->take_positions()) {
    watch_clock(position.packet);
    if (position.packet.nmea.empty() || position.packet.nmea == last_sentence_) continue;
    last_sentence_ = position.packet.nmea;
    fixes.push_back(fields_of(position));
  }
  if (fixes.empty()) return;
  const std::int64_t now_ns = stage_.now_ns();
  HeaderFields header = gnss_.header(now_ns, now_ns);
  header.run = window_.run();
  header.sweep = number_;
  header.stamp_ns = fixes.front().received_ns;
  header.replay = window_.replay();
  gnss_.publish(header, build_gnss(header, fixes));
}

void DriverStage::watch_clock(const PositionPacket& packet) {
  if (config_.clock != ClockChoice::kUtc) return;
  std::string text;
  if (packet.pps != Pps::kLocked) {
    text =
        "driver.clock is utc, but the sensor's pulse per second is not locked: its hour is not "
        "UTC's";
  } else if (const auto fix = parse_rmc(packet.nmea);
             fix && !agrees_with_utc(packet.toh_us, fix->utc_ns)) {
    text =
        "driver.clock is utc, but the sensor's minutes and seconds are not those of its receiver: "
        "the sensor has not taken over the receiver's time";
  }
  stage_.degraded("sensor clock", text);
}

void DriverStage::report_steps(const DecodedSweep& sweep) {
  report_step("host", sweep.host_clock_step_ns);
  report_step("sensor", sweep.sensor_clock_step_ns);
}

/// The stamps of a run continue across a step of a clock. Users who compare them with other times
/// must be told.
void DriverStage::report_step(const std::string& whose, std::int64_t step_ns) {
  if (step_ns == 0) return;
  std::array<char, 160> text{};
  std::snprintf(text.data(), text.size(),
                "the %s's clock was set by %+.3f s: the stamps of this run do not follow the step",
                whose.c_str(), 1e-9 * static_cast<double>(step_ns));
  runtime::log_warning(text.data(), {{"sweep", number_}});
  stage_.degraded("clock step", text.data());
  step_said_until_ = seconds_ + kStepSaidSeconds;
}

void DriverStage::watch_quiet(bool sweep_came) {
  const std::int64_t now_ns = steady_ns();
  const std::uint64_t datagrams =
      source_ ? count_of(source_->counts(), "packets_received") : stream_->data_packets();
  if (sweep_came || datagrams != seen_datagrams_) {
    seen_datagrams_ = datagrams;
    last_datagram_ns_ = now_ns;
    flushed_ = false;
    if (quiet_) {
      runtime::log_info("packets come again");
      stage_.degraded("packets", "");
    }
    quiet_ = false;
    return;
  }
  const std::int64_t silent_ns = now_ns - last_datagram_ns_;
  if (!flushed_ && silent_ns > kFlushAfterNs) {
    source_ ? source_->flush() : stream_->flush();
    flushed_ = true;
  }
  if (quiet_ || static_cast<double>(silent_ns) < 1e9 * config_.quiet_s) return;
  quiet_ = true;
  const std::string text = "no packets on " + place() + " for " +
                           std::to_string(static_cast<int>(config_.quiet_s)) + " s" +
                           advice_on_silence();
  runtime::log_warning(text);
  stage_.degraded("packets", text);
}

/// Reports data that come but give no sweep, as when all of them are damaged.
void DriverStage::watch_sweeps(bool sweep_came) {
  const std::int64_t now_ns = steady_ns();
  const bool data_come = now_ns - last_datagram_ns_ <= kFlushAfterNs;
  if (sweep_came || !data_come) no_sweep_since_ns_ = now_ns;
  // If no data come either, that is what is told.
  if (no_sweep_ && (sweep_came || quiet_)) {
    no_sweep_ = false;
    if (sweep_came) runtime::log_info("sweeps come again");
    stage_.degraded("sweeps", "");
  }
  const double least_s = std::max(config_.quiet_s, kNoSweepSeconds);
  if (no_sweep_ || static_cast<double>(now_ns - no_sweep_since_ns_) < 1e9 * least_s) return;
  no_sweep_ = true;
  const std::string text = "data come on " + place() + ", but no sweep for " +
                           std::to_string(static_cast<int>(least_s)) +
                           " s. Seen so far: " + counted(counts());
  runtime::log_warning(text);
  stage_.degraded("sweeps", text);
}

/// Where the sensor's data come in.
std::string DriverStage::place() const {
  if (!source_) return packets_.key();
  if (config_.source == SourceKind::kScip) return config_.path;
  return "UDP " + std::to_string(config_.udp.data_port);
}

std::string DriverStage::advice_on_silence() const {
  if (!source_) return {};
  if (config_.source == SourceKind::kScip) {
    return ": is the scanner on and connected, and is driver.path its address or device? Seen so "
           "far: " +
           counted(counts());
  }
  std::string text =
      ": is the sensor on and connected; does it send to this host or broadcast (its web page "
      "tells); is the port right (driver.port) and the sender (driver.sensor_address); does a "
      "firewall drop them; is it a model that is decoded here? Seen so far: " +
      counted(counts());
  if (const std::uint32_t other = source_->other_sender(); other != 0) {
    text += "; packets of such a sensor come from " + ipv4_text(other) +
            ", which is not this one (driver.sensor_address)";
  }
  if (const std::uint64_t unheard = to_closed_ports(); unheard > 0) {
    text += "; " + std::to_string(unheard) +
            " datagrams came to UDP ports of this host that no program listens on: if the "
            "sensor's are among them, driver.port is another (tcpdump -n udp shows it)";
  }
  return text;
}

std::uint64_t DriverStage::to_closed_ports() const {
  return datagrams_to_closed_ports() - to_closed_ports_before_;
}

NamedCounts DriverStage::counts() const { return source_ ? source_->counts() : stream_->counts(); }

void DriverStage::say_remarks() {
  for (const std::string& remark : source_ ? source_->remarks() : stream_->remarks()) {
    if (std::find(remarks_said_.begin(), remarks_said_.end(), remark) != remarks_said_.end()) {
      continue;
    }
    runtime::log_warning(remark);
    stage_.degraded("source " + std::to_string(remarks_said_.size()), remark);
    remarks_said_.push_back(remark);
  }
}

/// Reports problems as they begin and end.
void DriverStage::say_troubles() {
  const std::vector<std::string> now = source_ ? source_->troubles() : stream_->troubles();
  const auto is_in = [](const std::vector<std::string>& all, const std::string& text) {
    return std::find(all.begin(), all.end(), text) != all.end();
  };
  std::string all;
  for (const std::string& text : now) {
    if (!is_in(troubles_, text)) runtime::log_warning(text);
    all += (all.empty() ? "" : "; ") + text;
  }
  for (const std::string& text : troubles_) {
    if (!is_in(now, text)) runtime::log_info("no longer", {{"what", text}});
  }
  stage_.degraded("source", all);
  troubles_ = now;
}

void DriverStage::say_counts() {
  for (const auto& [name, count] : counts()) {
    stage_.figure(std::string(name), static_cast<double>(count));
  }
  if (config_.source == SourceKind::kUdp) {
    stage_.figure("datagrams_to_closed_ports", static_cast<double>(to_closed_ports()));
  }
  imu_->note_figures();
}

void DriverStage::every_second() {
  say_counts();
  say_remarks();
  say_troubles();
  if (seconds_ == step_said_until_) stage_.degraded("clock step", "");
  if (++seconds_ % kProgressSeconds == 0 && number_ > 0 && !last_published_) {
    const NamedCounts all = counts();
    runtime::log_info("progress", {{"sweeps", number_},
                                   {"packets", count_of(all, "packets_received")},
                                   {"lost", count_of(all, "packets_lost")},
                                   {"kernel_drops", count_of(all, "kernel_drops")}});
  }
}

}  // namespace zloam::driver
