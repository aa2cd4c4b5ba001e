#include "simulator/io/zenoh_sink.hpp"

#include <gtest/gtest.h>

#include "common/messages/verify.hpp"
#include "common/zenoh/aligned.hpp"
#include "common/zenoh/tests/support.hpp"
#include "simulator/vlp16.hpp"

namespace zloam::simulator {
namespace {

using zenoh::test::kPatience;
using zenoh::test::Mailbox;

constexpr std::int64_t kEpochNs = 1'704'067'210'000'000'000;

std::vector<Datagram> some_datagrams(std::int64_t count) {
  std::vector<Datagram> out;
  for (std::int64_t i = 0; i < count; ++i) {
    const bool data = i % 15 != 14;
    out.push_back({kEpochNs + i * 1'327'104, data ? vlp16::kDataPort : vlp16::kPositionPort, i,
                   std::vector<std::uint8_t>(data ? vlp16::kDataBytes : vlp16::kPositionBytes,
                                             static_cast<std::uint8_t>(i))});
  }
  return out;
}

ImuSource counted_imu() {
  return [next = std::int64_t{0}](std::int64_t until_ns) mutable {
    std::vector<ImuReading> readings;
    for (; next <= until_ns; next += 5'000'000) {
      ImuReading reading;
      reading.time_ns = next;
      reading.rate_rad_s = {0.0, 0.0, 0.5};
      reading.force_m_s2 = {0.0, 0.0, kGravity};
      readings.push_back(reading);
    }
    return readings;
  };
}

ZenohSinkConfig sink_config(int port) {
  ZenohSinkConfig config;
  config.robot = "r";
  config.sensor = "s";
  config.base_port = 0;
  config.connect = {zenoh::test::endpoint(port)};
  config.wait_s = 60.0;
  config.rate = 1000.0;
  config.block = true;
  return config;
}

template <class T>
const T* next_message(Mailbox& subscriber, zenoh::Sample& sample, zenoh::AlignedBytes& bytes) {
  auto received = subscriber.recv(kPatience);
  if (!received) {
    return nullptr;
  }
  sample = std::move(*received);
  bytes = zenoh::view_aligned(sample.payload);
  const VerifyResult result = verify<T>(bytes.data(), sample.encoding);
  EXPECT_TRUE(result.ok()) << result.reason;
  return result.ok() ? &message_of<T>(bytes.data()) : nullptr;
}

TEST(ZenohSink, EveryDatagramArrivesOnceAndInOrder) {
  const int port = zenoh::test::free_port();
  zenoh::Session reader = zenoh::Session::open(zenoh::test::listening_config(port));
  Mailbox imu(reader, "loam/r/imu/s");
  // Declared last: a publisher that sees this subscriber has seen the one before it.
  Mailbox packets(reader, "loam/r/lidar/s/packets");
  const auto sent = some_datagrams(400);
  const auto sink = zenoh_sink(sink_config(port), kEpochNs, counted_imu());
  sink->put(std::span(sent).first(133));
  sink->put(std::span(sent).subspan(133));
  sink->close();
  std::size_t k = 0;
  std::uint64_t number = 0;
  for (bool last = false; !last; ++number) {
    zenoh::Sample sample;
    zenoh::AlignedBytes bytes;
    const auto* message = next_message<msg::Packets>(packets, sample, bytes);
    ASSERT_NE(message, nullptr);
    EXPECT_EQ(message->header()->seq(), number);
    EXPECT_EQ(message->header()->sweep(), number);
    last = message->header()->end_of_run();
    std::int64_t first_ns = 0;
    for (const msg::PacketEntry* entry : *message->entries()) {
      ASSERT_LT(k, sent.size());
      EXPECT_EQ(entry->received_ns(), sent[k].sent_ns);
      EXPECT_EQ(entry->port(), sent[k].port);
      const std::span all(message->data()->data(), message->data()->size());
      const auto payload = all.subspan(entry->offset(), entry->length());
      EXPECT_TRUE(std::equal(payload.begin(), payload.end(), sent[k].payload.begin(),
                             sent[k].payload.end()));
      first_ns = first_ns == 0 ? entry->received_ns() : first_ns;
      EXPECT_LT(entry->received_ns() - first_ns, 100'000'000) << "one turn in a message";
      ++k;
    }
  }
  EXPECT_EQ(k, sent.size());
  std::int64_t next_ns = kEpochNs;
  for (bool last = false; !last;) {
    zenoh::Sample sample;
    zenoh::AlignedBytes bytes;
    const auto* message = next_message<msg::ImuBatch>(imu, sample, bytes);
    ASSERT_NE(message, nullptr);
    last = message->header()->end_of_run();
    for (const msg::ImuSample* reading : *message->samples()) {
      EXPECT_EQ(reading->stamp_ns(), next_ns);
      EXPECT_EQ(reading->linear_acceleration().z(), kGravity);
      EXPECT_EQ(reading->angular_velocity().z(), 0.5);
      next_ns += 5'000'000;
    }
  }
  EXPECT_GT(next_ns, sent.back().sent_ns);
}

TEST(ZenohSink, StartsWithoutAReaderAndRefusesBadNames) {
  ZenohSinkConfig config = sink_config(zenoh::test::free_port());
  config.wait_s = 0.0;
  const auto sink = zenoh_sink(config, kEpochNs, {});
  sink->put(some_datagrams(10));
  sink->close();
  config.robot = "a/b";
  EXPECT_THROW(zenoh_sink(config, kEpochNs, {}), std::invalid_argument);
}

}  // namespace
}  // namespace zloam::simulator
