// Answers other than success: SCIP 1, a scanner that is not ready, faults and single scans in a
// recorded session.

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdint>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "driver/scip/client.hpp"
#include "driver/scip/test_counts.hpp"
#include "driver/scip/test_device.hpp"

namespace zloam::driver::scip {
namespace {

constexpr std::int64_t kSecond = 1'000'000'000;
constexpr std::int64_t kMs = 1'000'000;

/// A client and a scanner that have not spoken with each other yet.
struct Dialogue {
  explicit Dialogue(const ClientConfig& config = {}) : client(config) {}

  void give(const std::string& bytes) {
    client.add({reinterpret_cast<const std::uint8_t*>(bytes.data()), bytes.size()}, now_ns);
  }

  void connect() {
    client.connected(now_ns);
    talk();
  }

  /// Until both are silent.
  void talk() {
    for (int i = 0; i < 100; ++i) {
      const std::string asked = client.take_output();
      if (asked.empty()) return;
      pass_quietly(kMs);
      give(device.respond(asked));
    }
    FAIL() << "they never stop";
  }

  void pass(std::int64_t ns) {
    pass_quietly(ns);
    client.look(now_ns);
    talk();
  }

  void pass_quietly(std::int64_t ns) {
    now_ns += ns;
    device.counter_ms += static_cast<std::uint32_t>(ns / kMs);
  }

  bool was_heard(const std::string& command) const {
    return std::find(device.heard.begin(), device.heard.end(), command) != device.heard.end();
  }

  std::uint64_t count(std::string_view name) const { return count_of(client, name); }

  TestDevice device;
  Client client;
  std::int64_t now_ns = 1'700'000'000 * kSecond;
};

/// A recorded session, read up to the scanner's parameters. measured: the command that its scans
/// answer.
struct Session : Dialogue {
  explicit Session(const std::string& measured) : Dialogue(replayed()) {
    device.measured = measured;
    connect();
    give(answer("PP", "00", TestDevice::parameters()));
  }

 private:
  static ClientConfig replayed() {
    ClientConfig config;
    config.asks = false;
    return config;
  }
};

TEST(ScipDialogue, AScannerInScip1IsChangedToScip2) {
  Dialogue dialogue;
  dialogue.device.scip1 = true;
  dialogue.connect();
  ASSERT_GE(dialogue.device.heard.size(), 2U);
  EXPECT_EQ(dialogue.device.heard[0], "QT");
  EXPECT_EQ(dialogue.device.heard[1], "SCIP2.0");
  EXPECT_TRUE(dialogue.client.measuring());
  EXPECT_EQ(dialogue.client.remarks(), std::vector<std::string>());
}

TEST(ScipDialogue, AScannerThatKnowsOnlyScip1IsNamedAndGivenUp) {
  Dialogue dialogue;
  dialogue.device.scip1 = dialogue.device.only_scip1 = true;
  dialogue.connect();
  bool gives_up = false;
  for (int i = 0; i < 5 && !gives_up; ++i) {
    dialogue.pass(1100 * kMs);
    gives_up = dialogue.client.take_reconnect();
  }
  EXPECT_TRUE(gives_up);
  ASSERT_EQ(dialogue.client.remarks().size(), 1U);
  EXPECT_NE(dialogue.client.remarks().front().find("SCIP 1"), std::string::npos);
  EXPECT_EQ(dialogue.count("answers_missing"), 0U);
}

TEST(ScipDialogue, AnUnstableScannerIsWaitedForAndNotRebooted) {
  for (const char* const command : {"PP", "TM0", "ME0000108001000"}) {
    SCOPED_TRACE(command);
    Dialogue dialogue;
    dialogue.device.broken_command = command;
    dialogue.device.broken_answer = answer(command, "0M");
    dialogue.connect();
    for (int i = 0; i < 8; ++i) {
      dialogue.pass(1100 * kMs);
      EXPECT_FALSE(dialogue.client.take_reconnect()) << i;
    }
    EXPECT_FALSE(dialogue.client.measuring());
    EXPECT_FALSE(dialogue.was_heard("RB"));
    EXPECT_EQ(dialogue.client.refusal(), "");
    EXPECT_EQ(dialogue.count("device_faults"), 0U);
    ASSERT_EQ(dialogue.client.remarks().size(), 1U);
    EXPECT_NE(dialogue.client.remarks().front().find("0M"), std::string::npos);
    dialogue.device.broken_command.clear();
    dialogue.pass(1100 * kMs);
    EXPECT_TRUE(dialogue.client.measuring());
  }
}

TEST(ScipDialogue, AnUnstableScannerThatMeasuresIsNotRebooted) {
  Dialogue dialogue;
  dialogue.connect();
  dialogue.give(answer("ME0000108001000", "0M"));
  dialogue.talk();
  EXPECT_FALSE(dialogue.was_heard("RB"));
  EXPECT_TRUE(dialogue.client.measuring());
}

TEST(ScipDialogue, FaultsInASessionAreCountedAndReadOver) {
  Session dialogue("ME0000108001000");
  dialogue.give(answer("II", "00", {told("STAT:Sensor is abnormal")}));
  for (int i = 0; i < 60; ++i) {
    dialogue.pass_quietly(25 * kMs);
    if (i == 50) dialogue.give(answer("ME0000108001000", "55"));
    dialogue.give(dialogue.device.scan());
  }
  dialogue.give(answer("ME0000108001000", "0L"));
  dialogue.client.flush();
  EXPECT_EQ(dialogue.count("device_faults"), 3U);
  EXPECT_EQ(dialogue.client.remarks().size(), 3U);
  EXPECT_EQ(dialogue.client.take_output(), "");
  int lines = 0;
  while (dialogue.client.take_scan()) ++lines;
  EXPECT_EQ(lines, 60);
}

/// Lines of all steps, as of a session that was recorded without a window.
std::vector<TimedScan> recorded_lines(const ClientConfig& config,
                                      std::vector<std::string>& remarks) {
  Dialogue dialogue(config);
  dialogue.device.measured = "ME0000108001000";
  dialogue.connect();
  dialogue.give(answer("PP", "00", TestDevice::parameters()));
  std::vector<TimedScan> lines;
  for (int i = 0; i < 60; ++i) {
    dialogue.pass_quietly(25 * kMs);
    dialogue.give(dialogue.device.scan());
    while (auto line = dialogue.client.take_scan()) lines.push_back(std::move(*line));
  }
  remarks = dialogue.client.remarks();
  return lines;
}

TEST(ScipDialogue, ASessionHasNoStepsBeyondTheWindow) {
  ClientConfig whole;
  whole.asks = false;
  ClientConfig front = whole;
  front.from_deg = -90.0;
  front.to_deg = 45.0;
  std::vector<std::string> remarks;
  const std::vector<TimedScan> all = recorded_lines(whole, remarks);
  const std::vector<TimedScan> cut = recorded_lines(front, remarks);
  ASSERT_EQ(all.size(), 60U);
  ASSERT_EQ(cut.size(), 60U);
  for (std::size_t i = 0; i < cut.size(); ++i) {
    EXPECT_EQ(all[i].scan.echoes.size(), 1081U);
    // 0.25 degrees a step, 540 at the front.
    ASSERT_EQ(cut[i].scan.echoes.size(), 541U);
    EXPECT_EQ(cut[i].scan.echoes.front().step, 180);
    EXPECT_EQ(cut[i].scan.echoes.back().step, 720);
    EXPECT_EQ(cut[i].scan.request.first_step, 180);
    EXPECT_EQ(cut[i].scan.request.last_step, 720);
    EXPECT_EQ(cut[i].stamp_ns, all[i].stamp_ns);
  }
  EXPECT_EQ(remarks, std::vector<std::string>());
}

TEST(ScipDialogue, ASessionWithoutStepsInTheWindowIsNamed) {
  ClientConfig beside;
  beside.asks = false;
  beside.from_deg = 136.0;
  beside.to_deg = 170.0;
  std::vector<std::string> remarks;
  for (const TimedScan& line : recorded_lines(beside, remarks)) {
    EXPECT_TRUE(line.scan.echoes.empty());
  }
  ASSERT_EQ(remarks.size(), 1U);
  EXPECT_NE(remarks.front().find("scanner.from_deg"), std::string::npos) << remarks.front();
}

TEST(ScipDialogue, ASessionsRefusedMeasurementIsNamed) {
  Session dialogue("");
  dialogue.give(answer("BM", "02"));
  dialogue.give(answer("ME0000108001000", "0E"));
  EXPECT_EQ(dialogue.client.remarks(),
            std::vector<std::string>({"the scanner gives no intensities: they are 0"}));
  dialogue.give(answer("MD0000108001000", "00"));
  EXPECT_EQ(dialogue.client.remarks().size(), 1U);
  for (const char* const command : {"MD0000108001000", "GD0000108001"}) {
    dialogue.give(answer(command, "10"));
    const std::string remark = dialogue.client.remarks().back();
    EXPECT_NE(remark.find(std::string(command, 2) + " was answered with status 10"),
              std::string::npos)
        << remark;
  }
  EXPECT_EQ(dialogue.client.remarks().size(), 3U);
  EXPECT_EQ(dialogue.count("device_faults"), 0U);
}

TEST(ScipDialogue, SingleScansDoNotDisturbTheCountOfRevolutions) {
  Session dialogue("MD0180090001000");
  // One each second before the measurement, and one of a revolution that is measured.
  std::vector<std::int64_t> expected = {1, 40, 40, 40, 40};
  for (int i = 0; i < 5; ++i) {
    dialogue.give(dialogue.device.single_scan());
    dialogue.pass_quietly(kSecond);
  }
  for (int i = 0; i < 60; ++i) {
    dialogue.give(dialogue.device.scan());
    expected.push_back(i == 0 ? 40 : 1);
    if (i == 30) {
      dialogue.give(dialogue.device.single_scan());
      expected.push_back(0);
    }
    dialogue.pass_quietly(25 * kMs);
  }
  dialogue.client.flush();
  std::vector<std::int64_t> turns;
  while (const auto scan = dialogue.client.take_scan()) turns.push_back(scan->turns);
  EXPECT_EQ(turns, expected);
  EXPECT_EQ(dialogue.count("scans_lost"), 0U);
}

TEST(ScipDialogue, ASingleScanBetweenLinesWithSkippedScans) {
  Session dialogue("MD0180090001300");
  std::vector<std::int64_t> expected;
  for (int i = 0; i < 20; ++i) {
    dialogue.give(dialogue.device.scan());
    dialogue.pass_quietly(50 * kMs);
    if (i == 10) dialogue.give(dialogue.device.single_scan());
    dialogue.pass_quietly(50 * kMs);
    expected.push_back(i == 0 ? 1 : i == 11 ? 2 : 4);
    if (i == 10) expected.push_back(2);
  }
  dialogue.client.flush();
  std::vector<std::int64_t> turns;
  while (const auto scan = dialogue.client.take_scan()) turns.push_back(scan->turns);
  EXPECT_EQ(turns, expected);
  EXPECT_EQ(dialogue.count("scans_lost"), 0U);
}

}  // namespace
}  // namespace zloam::driver::scip
