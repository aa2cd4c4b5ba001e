// Times of a scanner's lines: tied by its counter or by receive times, and across a set clock.

#include <gtest/gtest.h>

#include <cstdint>
#include <string>
#include <vector>

#include "driver/scip/client.hpp"
#include "driver/scip/test_device.hpp"

namespace zloam::driver::scip {
namespace {

constexpr std::int64_t kSecond = 1'000'000'000;
constexpr std::int64_t kMs = 1'000'000;

/// Times of 60 lines, each received 2 ms after its last step, against those of the counter.
std::vector<double> off_ms(bool tells_counter) {
  ClientConfig config;
  config.from_deg = -90.0;
  config.to_deg = 90.0;
  config.stamp_offset_ns = -2 * kMs;
  Client client(config);
  TestDevice device;
  if (!tells_counter) device.broken_command = "TM0";
  device.broken_answer = answer("TM0", "0E");
  constexpr std::int64_t kZeroNs = 1'700'000'000 * kSecond;
  const auto give = [&](const std::string& bytes, std::int64_t received_ns) {
    client.add({reinterpret_cast<const std::uint8_t*>(bytes.data()), bytes.size()}, received_ns);
  };
  client.connected(kZeroNs);
  std::int64_t now_ns = kZeroNs;
  for (std::string asked = client.take_output(); !asked.empty(); asked = client.take_output()) {
    device.counter_ms = static_cast<std::uint32_t>((now_ns - kZeroNs) / kMs);
    give(device.respond(asked), now_ns);
    now_ns += 1'000;
  }
  std::vector<double> off;
  for (int i = 0; i < 60; ++i) {
    const std::int64_t step0_ns = kZeroNs + (100 + 25 * i) * kMs;
    device.counter_ms = static_cast<std::uint32_t>(100 + 25 * i);
    // Step 900 ends 15.625 ms after step 0.
    give(device.scan(), step0_ns + 15'625'000 + 2 * kMs);
    while (auto scan = client.take_scan()) {
      const std::int64_t true_ns = kZeroNs + scan->scan.counter_ms * kMs;
      off.push_back(1e-6 * static_cast<double>(scan->stamp_ns - true_ns));
    }
  }
  return off;
}

TEST(ScipLineTimes, TheReceiveDelayIsTakenOffOnlyWhereReceiveTimesTieTheClock) {
  for (const bool tells_counter : {true, false}) {
    const std::vector<double> off = off_ms(tells_counter);
    ASSERT_EQ(off.size(), 60U);
    for (const double ms : off) EXPECT_NEAR(ms, 0.0, 0.6) << tells_counter;
  }
}

/// A recorded session of 400 lines; after 200 the host's clock was set.
void read_session(Client& client, std::int64_t host_step_ns) {
  TestDevice device;
  device.measured = "MD0180090001000";
  std::int64_t received_ns = 1'700'000'000 * kSecond;
  const auto give = [&](const std::string& bytes) {
    client.add({reinterpret_cast<const std::uint8_t*>(bytes.data()), bytes.size()}, received_ns);
  };
  client.connected(0);
  give(answer("PP", "00", TestDevice::parameters()));
  for (int i = 0; i < 400; ++i) {
    received_ns += 25 * kMs + (i == 200 ? host_step_ns : 0);
    device.counter_ms += 25;
    give(device.scan());
  }
  client.flush();
}

TEST(ScipLineTimes, ASetClockOfTheHostIsNoneOfTheScanner) {
  for (const std::int64_t step_ns : {-2 * kSecond, 5 * kSecond, -3600 * kSecond}) {
    SCOPED_TRACE(step_ns);
    ClientConfig config;
    config.asks = false;
    Client client(config);
    read_session(client, step_ns);
    std::vector<std::int64_t> stamps_ns;
    while (auto scan = client.take_scan()) {
      EXPECT_FALSE(scan->clock_step);
      stamps_ns.push_back(scan->stamp_ns);
    }
    ASSERT_EQ(stamps_ns.size(), 400U);
    for (std::size_t i = 1; i < stamps_ns.size(); ++i) {
      EXPECT_NEAR(static_cast<double>(stamps_ns[i] - stamps_ns[i - 1]), 25e6, 0.1e6) << i;
    }
    ASSERT_EQ(client.remarks().size(), 1U);
    EXPECT_NE(client.remarks().front().find("host"), std::string::npos) << client.remarks().front();
  }
}

}  // namespace
}  // namespace zloam::driver::scip
