#include "driver/io/sweep_source.hpp"

#include <array>
#include <cstdio>
#include <cstdlib>

#include "driver/io/look_ahead.hpp"

namespace zloam::driver {
namespace {

// Packets after which pull() of a live source returns at the latest, because commands and inertial
// readings received as messages wait for it.
constexpr int kPacketsPerPull = 8;
// Packets buffered of a sender that may be the sensor.
constexpr std::size_t kMostOfNewcomer = 2048;
// Packets, malformed ones among them, after which a stream begins with fewer data packets than
// would make its model certain.
constexpr std::size_t kMostFirst = 256;
// UTC that is off by this much was not taken over by the sensor when the run began.
constexpr std::int64_t kWrongUtcNs = 1'000'000'000;

class PacketSweeps : public SweepSource {
 public:
  PacketSweeps(std::unique_ptr<PacketSource> packets, const PacketStreamConfig& config,
               int timeout_ms)
      : packets_(std::move(packets)),
        ahead_(timeout_ms == 0
                   ? std::make_unique<LookAhead>(*packets_, config.decoding, config.sender)
                   : nullptr),
        stream_(tied(config, ahead_.get())),
        timeout_ms_(timeout_ms) {}

  Pull pull(DecodedSweep& sweep) override {
    Datagram datagram;
    for (int i = 0; timeout_ms_ == 0 || i < kPacketsPerPull; ++i) {
      if (stream_.take(sweep)) return Pull::kSweep;
      if (ended_) return Pull::kEnd;
      switch (ahead_ ? ahead_->next(datagram) : packets_->next(datagram, timeout_ms_)) {
        case Read::kDatagram:
          stream_.add(datagram);
          break;
        case Read::kTimeout:
          return Pull::kNothing;
        case Read::kEnd:
          stream_.flush();
          ended_ = true;
          break;
      }
    }
    return Pull::kNothing;
  }

  void flush() override { stream_.flush(); }
  std::uint32_t other_sender() const override { return stream_.other_sender(); }
  void record(bool on) override { stream_.record(on); }
  std::vector<RawPacket> take_packets() override { return stream_.take_packets(); }
  std::vector<ReceivedPosition> take_positions() override { return stream_.take_positions(); }
  std::vector<ImuReading> take_imu() override {
    std::vector<ImuReading> readings = packets_->take_imu();
    return readings.empty() ? stream_.take_imu() : readings;
  }

  std::vector<std::string> troubles() const override { return stream_.troubles(); }

  NamedCounts counts() const override {
    NamedCounts all = packets_->counts();
    const NamedCounts stream = stream_.counts();
    all.insert(all.end(), stream.begin(), stream.end());
    return all;
  }

  std::vector<std::string> remarks() const override {
    std::vector<std::string> all = stream_.remarks();
    if (const std::string text = packets_->complaint(); !text.empty()) all.push_back(text);
    return all;
  }

 private:
  static PacketStreamConfig tied(PacketStreamConfig config, const LookAhead* ahead) {
    if (ahead != nullptr) config.assembler.first_received_ns = ahead->first_received_ns();
    return config;
  }

  std::unique_ptr<PacketSource> packets_;
  /// For recordings only.
  std::unique_ptr<LookAhead> ahead_;
  PacketStream stream_;
  int timeout_ms_;
  bool ended_ = false;
};

class ScanSweeps : public SweepSource {
 public:
  ScanSweeps(std::unique_ptr<ScanFolder> scans, const PointLimits& limits)
      : scans_(std::move(scans)), limits_(limits), mask_(limits.mask) {}

  Pull pull(DecodedSweep& sweep) override {
    if (!scans_->next(sweep)) return Pull::kEnd;
    leave_out(sweep);
    return Pull::kSweep;
  }

  NamedCounts counts() const override {
    NamedCounts all = scans_->counts();
    all.emplace_back("points_masked", masked_);
    return all;
  }
  std::vector<std::string> remarks() const override { return scans_->remarks(); }
  std::vector<ImuReading> take_imu() override { return scans_->take_imu(); }

 private:
  void leave_out(DecodedSweep& sweep) {
    std::size_t kept = 0;
    for (std::size_t i = 0; i < sweep.points.size(); ++i) {
      const double range_m = sweep.points[i].position().cast<double>().norm();
      if (range_m < limits_.min_range_m || range_m > limits_.max_range_m) continue;
      if (mask_.active() && !mask_.keeps(sweep.points[i])) continue;
      sweep.points[kept] = sweep.points[i];
      sweep.columns[kept++] = sweep.columns[i];
    }
    masked_ += sweep.points.size() - kept;
    sweep.points.resize(kept);
    sweep.columns.resize(kept);
  }

  std::unique_ptr<ScanFolder> scans_;
  PointLimits limits_;
  PointMask mask_;
  std::uint64_t masked_ = 0;
};

}  // namespace

PacketStream::PacketStream(const PacketStreamConfig& config)
    : config_(config), makers_(config.decoding), filter_(config.port, config.sender, makers_) {}

void PacketStream::add(const Datagram& datagram) {
  const DatagramKind kind = filter_.classify(datagram);
  if (kind == DatagramKind::kForeign) return;
  if (kind == DatagramKind::kNewcomer) return keep_newcomer(datagram);
  recorded_.add(datagram.payload, datagram.received_ns, datagram.port);
  if (kind == DatagramKind::kPosition) return keep_position(datagram);
  if (kind == DatagramKind::kImu) return keep_imu(datagram);
  if (kind == DatagramKind::kMalformed) {
    return add_malformed(datagram.payload, datagram.received_ns);
  }
  if (kind != DatagramKind::kData) adopt(datagram, kind);
  newcomer_.clear();
  ++data_packets_;
  add_data(datagram.payload, datagram.received_ns);
}

void PacketStream::add_data(std::span<const std::uint8_t> payload, std::int64_t received_ns) {
  if (only_counts_) {
    before_data_ = assembler_->counts();
    assembler_.reset();
    only_counts_ = false;
  }
  if (assembler_) {
    assembler_->add(payload, received_ns);
    return;
  }
  first_.push_back({{{payload.begin(), payload.end()}, received_ns}, true});
  ++first_data_;
  begin_if_known();
}

/// Anybody can send to the sensor's port. What is no packet of the sensor is only counted: the
/// model is that of data packets alone.
void PacketStream::add_malformed(std::span<const std::uint8_t> payload, std::int64_t received_ns) {
  if (assembler_) {
    assembler_->add(payload, received_ns);
    return;
  }
  first_.push_back({{{payload.begin(), payload.end()}, received_ns}, false});
  begin_if_known();
}

void PacketStream::begin_if_known() {
  const std::size_t enough = makers_.maker().packets_to_know();
  const std::size_t most = first_data_ == 0 ? enough : kMostFirst;
  if (first_data_ >= enough || first_.size() >= most) begin();
}

void PacketStream::keep_newcomer(const Datagram& datagram) {
  if (datagram.sender != newcomer_sender_) newcomer_.clear();
  newcomer_sender_ = datagram.sender;
  if (newcomer_.size() == kMostOfNewcomer) return;
  newcomer_.push_back({{datagram.payload.begin(), datagram.payload.end()}, datagram.received_ns});
}

/// The sensor sends from another address. Its packets that were buffered until this was certain are
/// decoded now.
void PacketStream::adopt(const Datagram& datagram, DatagramKind kind) {
  remarks_.push_back("the sensor's packets come from " + ipv4_text(datagram.sender) +
                     " now: was it restarted, or is there a second sensor? Then set "
                     "driver.sensor_address");
  if (kind != DatagramKind::kAdopted) return;
  for (const Kept& kept : newcomer_) add_data(kept.payload, kept.received_ns);
  data_packets_ += newcomer_.size();
}

/// Called once there are enough packets to determine the model.
void PacketStream::begin() {
  FirstPackets data;
  for (const First& first : first_) {
    if (first.data) data.push_back(first.kept.payload);
  }
  only_counts_ = data.empty();
  assembler_ =
      std::make_unique<SweepAssembler>(makers_.maker().decoder(data, remarks_), config_.assembler);
  for (const First& first : first_) assembler_->add(first.kept.payload, first.kept.received_ns);
  first_.clear();
  first_data_ = 0;
}

void PacketStream::keep_position(const Datagram& datagram) {
  if (auto packet = makers_.maker().position(datagram.payload)) {
    positions_.push_back({std::move(*packet), datagram.received_ns});
  } else {
    ++bad_positions_;
  }
}

/// Readings before the first decoded packet are dropped: their time is not known yet, and no sweep
/// contains them.
void PacketStream::keep_imu(const Datagram& datagram) {
  if (!assembler_) return;
  for (ImuReading& reading : makers_.maker().imu(datagram.payload)) {
    const auto stamp_ns = assembler_->epoch_ns(reading.stamp_ns);
    if (!stamp_ns) return;
    reading.stamp_ns = *stamp_ns;
    imu_.push_back(reading);
  }
}

void PacketStream::flush() {
  if (!assembler_ && first_.empty()) return;
  if (!assembler_) begin();
  assembler_->flush();
}

NamedCounts PacketStream::counts() const {
  NamedCounts all = {{"datagrams_foreign", filter_.foreign()},
                     {"position_packets_bad", bad_positions_},
                     {"packets_not_recorded", recorded_.left_out()}};
  const NamedCounts before = before_data_.named();
  NamedCounts packets = (assembler_ ? assembler_->counts() : PacketCounts{}).named();
  for (std::size_t i = 0; i < packets.size(); ++i) packets[i].second += before[i].second;
  all.insert(all.end(), packets.begin(), packets.end());
  return all;
}

std::vector<std::string> PacketStream::remarks() const {
  std::vector<std::string> all = remarks_;
  if (const std::uint32_t second = filter_.second_sensor(); second != 0) {
    all.push_back("a second sensor sends from " + ipv4_text(second) +
                  ": its packets are left out; say which sensor is meant by "
                  "driver.sensor_address");
  }
  if (assembler_) {
    const auto& more = assembler_->decoder().contradictions();
    all.insert(all.end(), more.begin(), more.end());
  }
  return all;
}

std::vector<std::string> PacketStream::troubles() const {
  const std::int64_t ahead_ns = assembler_ ? assembler_->ahead_of_utc_ns() : 0;
  if (std::abs(ahead_ns) < kWrongUtcNs) return {};
  std::array<char, 200> text{};
  std::snprintf(text.data(), text.size(),
                "driver.clock is utc, but the stamps of this run are ahead of the sensor's UTC by "
                "%+.1f s: its clock was set after the run had begun; start the driver again",
                1e-9 * static_cast<double>(ahead_ns));
  return {text.data()};
}

std::string counted(const NamedCounts& counts) {
  std::string text;
  for (const auto& [name, count] : counts) {
    if (count == 0) continue;
    text += (text.empty() ? "" : ", ") + std::string(name) + " " + std::to_string(count);
  }
  return text.empty() ? "nothing at all" : text;
}

std::uint64_t count_of(const NamedCounts& counts, std::string_view name) {
  for (const auto& [key, count] : counts) {
    if (key == name) return count;
  }
  return 0;
}

std::unique_ptr<SweepSource> sweeps_of_packets(std::unique_ptr<PacketSource> packets,
                                               const PacketStreamConfig& config, int timeout_ms) {
  return std::make_unique<PacketSweeps>(std::move(packets), config, timeout_ms);
}

std::unique_ptr<SweepSource> sweeps_of_scans(std::unique_ptr<ScanFolder> scans,
                                             const PointLimits& limits) {
  return std::make_unique<ScanSweeps>(std::move(scans), limits);
}

}  // namespace zloam::driver
