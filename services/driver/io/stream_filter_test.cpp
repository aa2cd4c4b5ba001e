// Which datagrams belong to the sensor, and a sensor that returns with another address.
#include "driver/io/stream_filter.hpp"

#include <gtest/gtest.h>

#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "driver/io/look_ahead.hpp"
#include "driver/io/sweep_source.hpp"
#include "driver/velodyne/test_packets.hpp"

namespace zloam::driver {
namespace {

using velodyne::test::Payload;
using velodyne::test::TurningSensor;
using Bytes = std::vector<std::uint8_t>;

constexpr std::int64_t kStartNs = 1'700'000'000'000'000'000;
constexpr std::int64_t kPacketNs = 1'327'104;
constexpr std::uint32_t kFirst = 201;
constexpr std::uint32_t kOther = 77;

const Bytes kData(1206);

Datagram from(std::uint32_t sender, std::int64_t packet) {
  return {kData, kStartNs + kPacketNs * packet, 2368, sender};
}

TEST(StreamFilter, ByLengthAndOneSensorOnly) {
  const Bytes position(512), other(100);
  const auto at = [](const Bytes& bytes, unsigned port, std::uint32_t sender) {
    return Datagram{bytes, 0, static_cast<std::uint16_t>(port), sender};
  };
  Makers makers_of_filter({});
  StreamFilter filter(0, 0, makers_of_filter);
  EXPECT_EQ(filter.classify(at(other, 53, 9)), DatagramKind::kForeign);
  EXPECT_EQ(filter.classify(at(kData, 4000, 1)), DatagramKind::kData);
  EXPECT_EQ(filter.classify(at(kData, 4000, 2)), DatagramKind::kNewcomer);
  EXPECT_EQ(filter.classify(at(kData, 4001, 1)), DatagramKind::kForeign);
  EXPECT_EQ(filter.classify(at(position, 8308, 1)), DatagramKind::kPosition);
  EXPECT_EQ(filter.classify(at(other, 4000, 1)), DatagramKind::kMalformed);
  EXPECT_EQ(filter.foreign(), 3U);
  Makers makers_of_fixed({});
  StreamFilter fixed(2368, 7, makers_of_fixed);
  EXPECT_EQ(fixed.classify(at(kData, 2369, 7)), DatagramKind::kForeign);
  EXPECT_EQ(fixed.classify(at(kData, 2368, 8)), DatagramKind::kForeign);
  EXPECT_EQ(fixed.other_sender(), 8U);
  EXPECT_EQ(fixed.classify(at(kData, 2368, 7)), DatagramKind::kData);
}

TEST(StreamFilter, ASecondSensorIsNeverTaken) {
  Makers makers_of_filter({});
  StreamFilter filter(0, 0, makers_of_filter);
  for (std::int64_t i = 0; i < 100; ++i) {
    EXPECT_EQ(filter.classify(from(kFirst, i)), DatagramKind::kData);
    EXPECT_NE(filter.classify(from(kOther, i)), DatagramKind::kData);
  }
  // Also when the first sender stays silent.
  for (std::int64_t i = 100; i < 5000; ++i) {
    ASSERT_EQ(filter.classify(from(kOther, i)), DatagramKind::kForeign);
  }
  EXPECT_EQ(filter.foreign(), 5000U);
}

TEST(StreamFilter, ABurstOfAStrangerTakesNoPlace) {
  Makers makers_of_filter({});
  StreamFilter filter(0, 0, makers_of_filter);
  EXPECT_EQ(filter.classify(from(kFirst, 0)), DatagramKind::kData);
  for (int i = 0; i < 10'000; ++i) {
    ASSERT_EQ(filter.classify(from(kOther, 1)), DatagramKind::kNewcomer);
  }
  EXPECT_EQ(filter.classify(from(kFirst, 2)), DatagramKind::kData);
  EXPECT_EQ(filter.classify(from(kOther, 3)), DatagramKind::kForeign);
}

TEST(StreamFilter, TheFirstSenderTakesItsPlaceBack) {
  Makers makers_of_filter({});
  StreamFilter filter(0, 0, makers_of_filter);
  EXPECT_EQ(filter.classify(from(kFirst, 0)), DatagramKind::kData);
  std::int64_t packet = 1;
  while (filter.classify(from(kOther, packet)) == DatagramKind::kNewcomer) ++packet;
  EXPECT_EQ(filter.sender(), kOther);
  EXPECT_NEAR(static_cast<double>(packet * kPacketNs), 0.2e9, 2e6);
  EXPECT_EQ(filter.classify(from(kFirst, packet + 1)), DatagramKind::kReturned);
  EXPECT_EQ(filter.classify(from(kFirst, packet + 2)), DatagramKind::kData);
  EXPECT_EQ(filter.classify(from(kOther, packet + 3)), DatagramKind::kForeign);
}

std::size_t points_with_address_changed_at(std::int64_t change, bool with_times,
                                           PacketStream& stream) {
  TurningSensor sensor;
  for (std::int64_t i = 0; i < 1000; ++i) {
    const Payload payload = sensor.next();
    const std::int64_t received_ns = with_times ? kStartNs + kPacketNs * (i + 1) : 0;
    stream.add({payload, received_ns, 2368, i < change ? kFirst : kOther});
  }
  stream.flush();
  std::size_t points = 0;
  DecodedSweep sweep;
  while (stream.take(sweep)) points += sweep.points.size();
  return points;
}

TEST(PacketsForRecorder, AreBoundedAndCountedWhileNoSweepTakesThem) {
  const std::vector<std::uint8_t> payload(4, 7);
  PacketsForRecorder packets;
  packets.add(payload, 1, 2368);
  EXPECT_TRUE(packets.take().empty()) << "nobody records";
  packets.record(true);
  for (std::size_t i = 0; i < PacketsForRecorder::kMost + 5; ++i) packets.add(payload, 1, 2368);
  EXPECT_EQ(packets.left_out(), 5U);
  EXPECT_EQ(packets.take().size(), PacketsForRecorder::kMost);
  packets.add(payload, 2, 2368);
  packets.record(false);
  EXPECT_TRUE(packets.take().empty());
}

TEST(PacketStream, NothingIsLostWhenTheSensorHasAnotherAddress) {
  for (const bool with_times : {true, false}) {
    SCOPED_TRACE(with_times);
    PacketStream stream({});
    EXPECT_EQ(points_with_address_changed_at(500, with_times, stream), 1000U * 384U);
    ASSERT_EQ(stream.remarks().size(), 1U);
    EXPECT_NE(stream.remarks()[0].find("0.0.0.77"), std::string::npos);
    EXPECT_EQ(stream.data_packets(), 1000U);
  }
}

TEST(PacketStream, ASensorThatWasNamedIsNoOther) {
  PacketStreamConfig config;
  config.sender = kFirst;
  PacketStream stream(config);
  EXPECT_EQ(points_with_address_changed_at(500, true, stream), 500U * 384U);
  EXPECT_EQ(stream.other_sender(), kOther);
}

// Which of two sensors is heard first is chance.
TEST(PacketStream, ASecondSensorIsSaidWhereNoneWasNamed) {
  for (const std::uint32_t named : {0U, kFirst}) {
    SCOPED_TRACE(named);
    PacketStreamConfig config;
    config.sender = named;
    PacketStream stream(config);
    TurningSensor first, other;
    for (std::int64_t i = 0; i < 300; ++i) {
      const Payload of_first = first.next(), of_other = other.next();
      stream.add({of_first, kStartNs + kPacketNs * i, 2368, kFirst});
      stream.add({of_other, kStartNs + kPacketNs * i + 1, 2368, kOther});
    }
    stream.flush();
    EXPECT_EQ(count_of(stream.counts(), "datagrams_foreign"), 300U);
    EXPECT_EQ(count_of(stream.counts(), "points"), 300U * 384U);
    ASSERT_EQ(stream.remarks().size(), named == 0 ? 1U : 0U);
    for (const std::string& remark : stream.remarks()) {
      EXPECT_NE(remark.find("0.0.0.77"), std::string::npos) << remark;
    }
  }
}

TEST(PacketStream, AStrayPacketIsNoSecondSensor) {
  PacketStream stream(PacketStreamConfig{});
  TurningSensor first, other;
  for (std::int64_t i = 0; i < 300; ++i) {
    const Payload of_first = first.next(), of_other = other.next();
    stream.add({of_first, kStartNs + kPacketNs * i, 2368, kFirst});
    if (i % 100 == 50) stream.add({of_other, kStartNs + kPacketNs * i + 1, 2368, kOther});
  }
  stream.flush();
  EXPECT_EQ(count_of(stream.counts(), "datagrams_foreign"), 3U);
  EXPECT_TRUE(stream.remarks().empty());
}

PacketStreamConfig of_port_2368() {
  PacketStreamConfig config;
  config.port = 2368;
  config.decoding.declared_model = "VLP-16";
  return config;
}

// Anybody can send to the port: nmap -sU does so without payload.
TEST(PacketStream, WhatIsNoPacketOfTheSensorIsOnlyCounted) {
  const Bytes nothing, noise(100, 0xFF);
  for (const std::size_t probes : {1U, 7U, 30U}) {
    SCOPED_TRACE(probes);
    PacketStream stream(of_port_2368());
    for (std::size_t i = 0; i < probes; ++i) stream.add({nothing, kStartNs, 2368, kOther});
    stream.add({noise, kStartNs, 2368, kOther});
    EXPECT_EQ(points_with_address_changed_at(1000, true, stream), 1000U * 384U);
    EXPECT_EQ(count_of(stream.counts(), "packets_foreign"), probes + 1);
    EXPECT_EQ(count_of(stream.counts(), "packets_received"), probes + 1001);
  }
  PacketStream silent(of_port_2368());
  for (int i = 0; i < 7; ++i) silent.add({nothing, kStartNs, 2368, kOther});
  silent.flush();
  EXPECT_EQ(count_of(silent.counts(), "packets_foreign"), 7U);
}

TEST(PacketStream, AMalformedPacketHidesNoMislabelledModel) {
  for (const std::size_t malformed : {0U, 1U, 7U}) {
    SCOPED_TRACE(malformed);
    PacketStream stream(of_port_2368());
    const Bytes noise(100, 0x22);
    for (std::size_t i = 0; i < malformed; ++i) stream.add({noise, kStartNs, 2368, kFirst});
    TurningSensor sensor;
    sensor.product_id = 0x21;  // an HDL-32E's, at the rate of a VLP-16
    for (int i = 0; i < 300; ++i) {
      const Payload payload = sensor.next();
      stream.add({payload, kStartNs + kPacketNs * (i + 1), 2368, kFirst});
    }
    stream.flush();
    DecodedSweep sweep;
    ASSERT_TRUE(stream.take(sweep));
    EXPECT_EQ(sweep.model, "vlp16");
  }
}

// Robot and lidar are switched on together: the sensor's hour counts from then on until it has the
// time of its receiver.
TEST(PacketStream, SaysUntilTheEndThatTheSensorTookOverUtcTooLate) {
  constexpr std::int64_t kTwentyToEleven = 1'700'001'600'000'000'000;  // 40 minutes past the hour
  for (const ClockMode mode : {ClockMode::kUtc, ClockMode::kReceive}) {
    PacketStreamConfig config;
    config.assembler.clock_mode = mode;
    PacketStream stream(config);
    TurningSensor sensor;
    sensor.time_us = 90e6;
    for (std::int64_t i = 0; i < 900; ++i) {
      if (i == 300) {
        EXPECT_TRUE(stream.troubles().empty());
        sensor.time_us += 2310e6;
      }
      const Payload payload = sensor.next();
      stream.add({payload, kTwentyToEleven + kPacketNs * (i + 1), 2368, kFirst});
    }
    const std::vector<std::string> troubles = stream.troubles();
    ASSERT_EQ(troubles.size(), mode == ClockMode::kUtc ? 1U : 0U);
    // One minute and a half past the next hour is nearer than past this one: 21.5 minutes ahead.
    for (const std::string& text : troubles) {
      EXPECT_NE(text.find("ahead of the sensor's UTC by +1290.0 s"), std::string::npos) << text;
    }
  }
}

/// An ideal sensor's recording; received_ns maps the send time to the receive time.
class Recording : public PacketSource {
 public:
  explicit Recording(std::function<std::int64_t(std::int64_t)> received_ns,
                     std::uint32_t sender = kFirst)
      : received_ns_(std::move(received_ns)), sender_(sender) {}

  Read next(Datagram& datagram, int /*timeout_ms*/) override {
    if (packets_ == 3000) return Read::kEnd;
    payload_ = sensor_.next();
    datagram = {payload_, received_ns_(kStartNs + kPacketNs * ++packets_), 2368, sender_};
    return Read::kDatagram;
  }
  NamedCounts counts() const override { return {}; }

 private:
  std::function<std::int64_t(std::int64_t)> received_ns_;
  std::uint32_t sender_;
  TurningSensor sensor_;
  Payload payload_;
  std::int64_t packets_ = 0;
};

/// Packets whose stamps do not advance.
class Standing : public PacketSource {
 public:
  Read next(Datagram& datagram, int /*timeout_ms*/) override {
    datagram = from(kFirst, packets_++);
    return packets_ > 20'000 ? Read::kEnd : Read::kDatagram;
  }
  NamedCounts counts() const override { return {}; }
  std::int64_t packets() const { return packets_; }

 private:
  std::int64_t packets_ = 0;
};

// Without their metadata, an Ouster's stamps are unknown: it fills a gigabyte in a minute.
TEST(LookAhead, ReadsNoFurtherWhereTheStampsStand) {
  Standing standing;
  const LookAhead ahead(standing, {});
  EXPECT_LE(standing.packets(), 3'000'000'000 / kPacketNs + 2);
  EXPECT_EQ(ahead.first_received_ns(), 0);
}

/// Packets of another sensor, as large as IP allows.
class Large : public PacketSource {
 public:
  Read next(Datagram& datagram, int /*timeout_ms*/) override {
    datagram = {payload_, kStartNs + kPacketNs * packets_++, 2368, kOther};
    return packets_ > 6000 ? Read::kEnd : Read::kDatagram;
  }
  NamedCounts counts() const override { return {}; }
  std::int64_t packets() const { return packets_; }

 private:
  Bytes payload_ = Bytes(65'000);
  std::int64_t packets_ = 0;
};

// The sensor was named by a wrong address: all that is read meanwhile stays in memory.
TEST(LookAhead, ReadsNoGigabytesWhereTheNamedSensorSendsNothing) {
  Large large;
  const LookAhead ahead(large, {}, kFirst);
  EXPECT_LE(large.packets(), (256 << 20) / 65'000 + 1);
  EXPECT_EQ(ahead.first_received_ns(), 0);
}

/// One recording after the other, as a single one.
class Joined : public PacketSource {
 public:
  Joined(Recording first, Recording second)
      : first_(std::move(first)), second_(std::move(second)) {}

  Read next(Datagram& datagram, int timeout_ms) override {
    const Read read = first_.next(datagram, timeout_ms);
    return read == Read::kEnd ? second_.next(datagram, timeout_ms) : read;
  }
  NamedCounts counts() const override { return {}; }

 private:
  Recording first_, second_;
};

TEST(LookAhead, OfASensorThatWasNamedOnlyItsOwnPacketsCount) {
  constexpr std::int64_t kLaterNs = 5'000'000'000;
  const auto burst = [](std::int64_t sent_ns) {
    return std::max(sent_ns, kStartNs + 1'000'000'000);
  };
  const auto later = [](std::int64_t sent_ns) { return sent_ns + kLaterNs; };
  PacketStreamConfig config;
  config.sender = kFirst;
  const auto source = sweeps_of_packets(
      std::make_unique<Joined>(Recording(burst, kOther), Recording(later, kFirst)), config, 0);
  DecodedSweep sweep;
  ASSERT_EQ(source->pull(sweep), Pull::kSweep);
  EXPECT_NEAR(static_cast<double>(sweep.stamp_ns - kStartNs - kLaterNs), 0.0, 1.4e6);
}

TEST(LookAhead, GivesTheTrueStartAndLeavesNothingOut) {
  const std::int64_t whole_s = 1'000'000'000;
  const std::vector<std::function<std::int64_t(std::int64_t)>> arrivals = {
      [](std::int64_t sent_ns) { return sent_ns; },
      [](std::int64_t sent_ns) { return sent_ns + sent_ns % 1'000'000; },
      [&](std::int64_t sent_ns) {
        return (sent_ns + whole_s / 3) / whole_s * whole_s - whole_s / 3;
      },
      [](std::int64_t sent_ns) { return std::max(sent_ns, kStartNs + 800'000'000); },
      [](std::int64_t sent_ns) {
        return sent_ns < kStartNs + kPacketNs * 2 ? sent_ns + 300'000'000 : sent_ns;
      },
  };
  for (std::size_t i = 0; i < arrivals.size(); ++i) {
    SCOPED_TRACE(i);
    const auto source = sweeps_of_packets(std::make_unique<Recording>(arrivals[i]), {}, 0);
    DecodedSweep sweep;
    std::size_t points = 0;
    while (source->pull(sweep) == Pull::kSweep) {
      if (points == 0) {
        EXPECT_NEAR(static_cast<double>(sweep.stamp_ns - kStartNs), 0.0, 1.4e6);
      }
      points += sweep.points.size();
    }
    EXPECT_EQ(points, 3000U * 384U);
  }
}

}  // namespace
}  // namespace zloam::driver
