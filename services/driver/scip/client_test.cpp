// The dialogue with a scanner, including its faults, and the times of its lines.

#include "driver/scip/client.hpp"

#include <gtest/gtest.h>

#include "driver/scip/test_counts.hpp"
#include "driver/scip/test_device.hpp"

namespace zloam::driver::scip {
namespace {

constexpr std::int64_t kSecond = 1'000'000'000;
constexpr std::int64_t kMs = 1'000'000;

class ScipClient : public ::testing::Test {
 protected:
  static ClientConfig half_circle() {
    ClientConfig config;
    config.from_deg = -90.0;
    config.to_deg = 90.0;
    return config;
  }

  explicit ScipClient(const ClientConfig& config = half_circle()) : client_(config) {
    client_.connected(now_ns_);
    talk();
  }

  void give(const std::string& bytes) {
    client_.add({reinterpret_cast<const std::uint8_t*>(bytes.data()), bytes.size()}, now_ns_);
  }

  /// Exchanges messages until client and device are silent; each message takes a millisecond.
  void talk() {
    for (int i = 0; i < 100; ++i) {
      const std::string asked = client_.take_output();
      if (asked.empty()) return;
      now_ns_ += kMs;
      device_.counter_ms += 1;
      const std::string said = device_.respond(asked);
      now_ns_ += kMs;
      device_.counter_ms += 1;
      if (!said.empty()) give(said);
    }
    FAIL() << "they never stop";
  }

  void pass(std::int64_t ns) {
    now_ns_ += ns;
    device_.counter_ms += static_cast<std::uint32_t>(ns / kMs);
    client_.look(now_ns_);
    talk();
  }

  /// Measures this many lines, 25 ms apart.
  void measure(int lines) {
    for (int i = 0; i < lines; ++i) {
      pass(25 * kMs);
      give(device_.scan());
    }
  }

  std::vector<TimedScan> taken() {
    std::vector<TimedScan> all;
    while (auto scan = client_.take_scan()) all.push_back(std::move(*scan));
    return all;
  }

  std::uint64_t count(std::string_view name) const { return count_of(client_, name); }

  TestDevice device_;
  Client client_;
  std::int64_t now_ns_ = 1'700'000'000 * kSecond;
};

TEST_F(ScipClient, StopsAsksTiesAndStarts) {
  EXPECT_TRUE(client_.measuring());
  ASSERT_GE(device_.heard.size(), 8U);
  EXPECT_EQ(device_.heard.front(), "QT");
  EXPECT_EQ(device_.heard.back(), "ME0180090001000");
  EXPECT_EQ(std::count(device_.heard.begin(), device_.heard.end(), "TM1"), 10);
  EXPECT_FALSE(device_.adjusting);
  EXPECT_EQ(client_.remarks(), std::vector<std::string>());
  EXPECT_EQ(client_.parameters()->model, "UTM-30LX-EW");
}

TEST_F(ScipClient, LinesHaveTheTimeOfTheirCounter) {
  // Host time when the counter was zero.
  const std::int64_t zero_ns = now_ns_ - device_.counter_ms * kMs;
  measure(60);
  const auto scans = taken();
  ASSERT_EQ(scans.size(), 60U);
  for (const TimedScan& scan : scans) {
    const std::int64_t true_ns = zero_ns + scan.scan.counter_ms * kMs;
    EXPECT_NEAR(static_cast<double>(scan.stamp_ns - true_ns), 0.0, 1.1e6);
    EXPECT_EQ(scan.turns, 1);
  }
}

TEST_F(ScipClient, EvenReceiveTimesAreNoDrift) {
  // One minute in which the host's clock and the counter run at the same rate and every line has
  // the same delay.
  measure(2400);
  const auto scans = taken();
  ASSERT_EQ(scans.size(), 2400U);
  const auto off_ns = [&](const TimedScan& scan) {
    return scan.stamp_ns - scan.scan.counter_ms * kMs;
  };
  EXPECT_NEAR(static_cast<double>(off_ns(scans.back()) - off_ns(scans.front())), 0.0, 0.1e6);
}

TEST_F(ScipClient, TheCounterWraps) {
  device_.counter_ms = 0x1000000 - 500;
  client_.connected(now_ns_);
  talk();
  measure(80);
  const auto scans = taken();
  ASSERT_EQ(scans.size(), 80U);
  for (std::size_t i = 1; i < scans.size(); ++i) {
    EXPECT_NEAR(static_cast<double>(scans[i].stamp_ns - scans[i - 1].stamp_ns), 25e6, 1e6) << i;
  }
  EXPECT_EQ(count("clock_steps"), 0U);
}

TEST_F(ScipClient, ARestartedCounterGoesOn) {
  measure(60);
  device_.counter_ms = 100;
  measure(5);
  const auto scans = taken();
  ASSERT_EQ(scans.size(), 65U);
  EXPECT_NEAR(static_cast<double>(scans[60].stamp_ns - scans[59].stamp_ns), 25e6, 2e6);
  EXPECT_TRUE(scans[60].clock_step);
  EXPECT_FALSE(scans[61].clock_step);
  EXPECT_EQ(count("clock_steps"), 1U);
}

TEST_F(ScipClient, AScannerThatWasStartedAgainIsTiedAgain) {
  measure(60);
  const std::int64_t off_s = 20;
  now_ns_ += off_s * kSecond;
  device_.counter_ms = 300;
  client_.connected(now_ns_);
  talk();
  const std::int64_t zero_ns = now_ns_ - device_.counter_ms * kMs;
  taken();
  for (int i = 0; i < 60; ++i) {
    pass(25 * kMs);
    // The connection's first line comes 10 ms late.
    const std::string scan = device_.scan();
    now_ns_ += i == 0 ? 10 * kMs : 0;
    give(scan);
    now_ns_ -= i == 0 ? 10 * kMs : 0;
  }
  const auto scans = taken();
  ASSERT_EQ(scans.size(), 60U);
  for (const TimedScan& scan : scans) {
    const std::int64_t true_ns = zero_ns + scan.scan.counter_ms * kMs;
    EXPECT_NEAR(static_cast<double>(scan.stamp_ns - true_ns), 0.0, 1.1e6);
  }
  // 25 ms a revolution.
  EXPECT_NEAR(static_cast<double>(scans.front().turns), 40.0 * off_s, 4.0);
  EXPECT_EQ(scans[1].turns, 1);
}

TEST_F(ScipClient, LostLinesAreCountedByTheCounter) {
  measure(50);
  pass(75 * kMs);
  measure(5);
  const auto scans = taken();
  ASSERT_EQ(scans.size(), 55U);
  EXPECT_EQ(scans[50].turns, 4);
  EXPECT_EQ(count("scans_lost"), 3U);
}

TEST_F(ScipClient, AWrongChecksumDropsOneScan) {
  measure(50);
  pass(25 * kMs);
  std::string bad = device_.scan();
  bad[bad.size() / 2] ^= 1;
  give(bad);
  measure(5);
  EXPECT_EQ(taken().size(), 55U);
  EXPECT_EQ(count("replies_bad_checksum"), 1U);
  EXPECT_EQ(count("scans_lost"), 1U);
  EXPECT_TRUE(client_.measuring());
}

TEST_F(ScipClient, ThreeBadScansStartItAgain) {
  measure(45);
  for (int i = 0; i < 3; ++i) {
    pass(25 * kMs);
    std::string bad = device_.scan();
    bad[bad.size() / 2] ^= 1;
    give(bad);
  }
  talk();
  EXPECT_EQ(count("restarts"), 1U);
  EXPECT_TRUE(client_.measuring());
  measure(5);
  EXPECT_EQ(taken().size(), 50U);
}

TEST_F(ScipClient, AStreamFromBeforeIsNotOurs) {
  device_.measured = "MD0000108001000";
  Client late(half_circle());
  late.connected(now_ns_);
  const std::string stale = device_.scan() + device_.scan();
  late.add({reinterpret_cast<const std::uint8_t*>(stale.data()), stale.size()}, now_ns_);
  EXPECT_FALSE(late.take_scan().has_value());
  EXPECT_EQ(late.take_output(), "QT\n");
}

TEST_F(ScipClient, SilenceWhileItMeasuresAsksForANewConnection) {
  measure(50);
  EXPECT_FALSE(client_.take_reconnect());
  pass(1500 * kMs);
  EXPECT_TRUE(client_.take_reconnect());
  client_.connected(now_ns_);
  talk();
  EXPECT_TRUE(client_.measuring());
}

TEST_F(ScipClient, WhatNeverAnswersIsGivenUp) {
  device_.silent = true;
  client_.connected(now_ns_);
  talk();
  bool gives_up = false;
  for (int i = 0; i < 5 && !gives_up; ++i) {
    pass(1100 * kMs);
    gives_up = client_.take_reconnect();
  }
  EXPECT_TRUE(gives_up);
  ASSERT_FALSE(client_.remarks().empty());
  EXPECT_NE(client_.remarks().front().find("driver.path"), std::string::npos);
}

TEST_F(ScipClient, ADialogueThatNeverEndsIsGivenUp) {
  for (const char* const command : {"VV", "II", "TM0", "ME0180090001000"}) {
    SCOPED_TRACE(command);
    device_.broken_command = command;
    device_.broken_answer = "";
    Client client(half_circle());
    client.connected(now_ns_);
    bool gives_up = false;
    for (int i = 0; i < 400 && !gives_up; ++i) {
      const std::string said = device_.respond(client.take_output());
      client.add({reinterpret_cast<const std::uint8_t*>(said.data()), said.size()}, now_ns_);
      now_ns_ += 10 * kMs;
      client.look(now_ns_);
      gives_up = client.take_reconnect();
    }
    EXPECT_TRUE(gives_up);
    ASSERT_EQ(client.remarks().size(), 1U);
    EXPECT_NE(client.remarks().front().find(std::string("no answer to ") + command),
              std::string::npos);
  }
}

TEST_F(ScipClient, WithoutIntensitiesItMeasuresDistances) {
  device_.broken_command = "ME0180090001000";
  device_.broken_answer = answer("ME0180090001000", "0E");
  client_.connected(now_ns_);
  talk();
  EXPECT_EQ(device_.heard.back(), "MD0180090001000");
  EXPECT_TRUE(client_.measuring());
  EXPECT_EQ(client_.remarks().size(), 1U);
}

TEST_F(ScipClient, AFaultOfTheDeviceRebootsIt) {
  measure(45);
  give(answer("ME0180090001000", "55"));
  EXPECT_EQ(client_.take_output(), "RB\nRB\n");
  EXPECT_EQ(count("device_faults"), 1U);
  pass(11 * kSecond);
  EXPECT_TRUE(client_.take_reconnect());
}

TEST_F(ScipClient, AFaultThatIsRepeatedIsOneReboot) {
  measure(45);
  bool reconnects = false;
  std::string asked;
  for (int i = 0; i < 12 * 40 && !reconnects; ++i) {
    give(answer("ME0180090001000", "55"));
    asked += client_.take_output();
    now_ns_ += 25 * kMs;
    client_.look(now_ns_);
    reconnects = client_.take_reconnect();
  }
  EXPECT_TRUE(reconnects);
  EXPECT_EQ(asked, "RB\nRB\n");
}

TEST_F(ScipClient, AScannerThatCallsItselfAbnormalIsRebooted) {
  device_.broken_command = "II";
  device_.broken_answer = answer("II", "00", {told("STAT:Sensor is abnormal")});
  client_.connected(now_ns_);
  talk();
  EXPECT_FALSE(client_.measuring());
  EXPECT_EQ(device_.heard.back(), "RB");
  ASSERT_EQ(client_.remarks().size(), 1U);
  EXPECT_NE(client_.remarks().front().find("abnormal"), std::string::npos);
  pass(11 * kSecond);
  EXPECT_TRUE(client_.take_reconnect());
}

TEST_F(ScipClient, ASelfCheckIsWaitedFor) {
  measure(45);
  give(answer("ME0180090001000", "30"));
  EXPECT_EQ(client_.take_output(), "");
  EXPECT_TRUE(client_.measuring());
  give(answer("ME0180090001000", "98"));
  measure(3);
  EXPECT_EQ(taken().size(), 48U);
}

TEST_F(ScipClient, ASelfCheckAtTheStartIsWaitedFor) {
  device_.broken_command = "ME0180090001000";
  device_.broken_answer = answer("ME0180090001000", "30");
  client_.connected(now_ns_);
  talk();
  for (int i = 0; i < 8; ++i) {
    pass(1100 * kMs);
    EXPECT_FALSE(client_.take_reconnect()) << i;
  }
  EXPECT_FALSE(client_.measuring());
  ASSERT_EQ(client_.remarks().size(), 1U);
  EXPECT_NE(client_.remarks().front().find("status 30"), std::string::npos);
  EXPECT_EQ(count("answers_missing"), 0U);
  device_.broken_command.clear();
  pass(1100 * kMs);
  EXPECT_TRUE(client_.measuring());
}

TEST_F(ScipClient, AfterASelfCheckAtTheStartItMeasures) {
  device_.broken_command = "ME0180090001000";
  device_.broken_answer = answer("ME0180090001000", "30");
  client_.connected(now_ns_);
  talk();
  device_.measured = "ME0180090001000";
  give(answer("ME0180090001000", "98"));
  EXPECT_EQ(client_.refusal(), "");
  EXPECT_TRUE(client_.measuring());
  measure(45);
  EXPECT_EQ(taken().size(), 45U);
}

TEST_F(ScipClient, ARefusalNamesTheReason) {
  device_.broken_command = "ME0180090001000";
  device_.broken_answer = answer("ME0180090001000", "04");
  client_.connected(now_ns_);
  talk();
  EXPECT_NE(client_.refusal().find("beyond"), std::string::npos) << client_.refusal();
}

TEST_F(ScipClient, ParametersThatCantBeAreSaid) {
  device_.broken_command = "PP";
  device_.broken_answer = answer("PP", "00", {told("DMIN:23"), told("DMAX:60000")});
  client_.connected(now_ns_);
  talk();
  ASSERT_FALSE(client_.remarks().empty());
  EXPECT_NE(client_.remarks().front().find("ARES"), std::string::npos);
  // It is tried again, and never called silent.
  bool gives_up = false;
  for (int i = 0; i < 5 && !gives_up; ++i) {
    pass(1100 * kMs);
    gives_up = client_.take_reconnect();
  }
  EXPECT_TRUE(gives_up);
  EXPECT_EQ(client_.remarks().size(), 1U);
  EXPECT_EQ(count("answers_missing"), 0U);
}

}  // namespace
}  // namespace zloam::driver::scip
