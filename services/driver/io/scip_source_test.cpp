// Recorded sessions of a scanner: what they report, and the sweeps of their lines.

#include "driver/io/scip_source.hpp"

#include <gtest/gtest.h>
#include <unistd.h>

#include <cstdint>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "driver/scip/test_device.hpp"

namespace zloam::driver {
namespace {

constexpr std::int64_t kMs = 1'000'000;
constexpr std::int64_t kBeginNs = 1'700'000'000'000 * kMs;

/// Writes a session while the time passes that a scanner would take.
class SessionWriter {
 public:
  SessionWriter()
      : path_(std::filesystem::temp_directory_path() /
              ("zloam_session_" + std::to_string(getpid()) + ".logr")),
        file_(path_, std::ios::binary) {
    device_.measured = "MD0180090001000";
    record(scip::answer("PP", "00", scip::TestDevice::parameters()));
  }
  ~SessionWriter() { std::filesystem::remove(path_); }
  SessionWriter(const SessionWriter&) = delete;
  SessionWriter& operator=(const SessionWriter&) = delete;

  void record(const std::string& bytes) {
    put(static_cast<std::uint32_t>(at_ns_ / 1'000'000'000));
    put(static_cast<std::uint32_t>(at_ns_ / 1'000 % 1'000'000));
    put(static_cast<std::uint32_t>(bytes.size()));
    file_ << bytes << std::flush;
  }
  void pass(std::int64_t ms) {
    at_ns_ += ms * kMs;
    device_.counter_ms += static_cast<std::uint32_t>(ms);
  }
  void lines(int count) {
    for (int i = 0; i < count; ++i) {
      pass(25);
      record(device_.scan());
    }
  }
  void single() { record(device_.single_scan()); }
  std::string path() const { return path_.string(); }

 private:
  void put(std::uint32_t number) {
    for (const int shift : {24, 16, 8, 0}) file_.put(static_cast<char>(number >> shift & 0xFFU));
  }

  std::filesystem::path path_;
  std::ofstream file_;
  scip::TestDevice device_;
  std::int64_t at_ns_ = kBeginNs;
};

std::vector<DecodedSweep> sweeps_from(ScipSource& source) {
  std::vector<DecodedSweep> all;
  DecodedSweep sweep;
  while (source.pull(sweep) == Pull::kSweep) all.push_back(std::move(sweep));
  return all;
}

TEST(ScipSession, LinesWithoutAnglesNameTheGapThatReadingsMayHave) {
  SessionWriter session;
  session.lines(200);
  // One reading in 60 ms.
  std::vector<spinning::AngleReading> readings;
  for (std::int64_t at_ms = 0; at_ms < 6'000; at_ms += 60) {
    readings.push_back({kBeginNs + at_ms * kMs, 1e-3 * static_cast<double>(at_ms)});
  }
  const auto source = sweeps_of_session(session.path(), readings, ScipSourceConfig{});
  EXPECT_TRUE(sweeps_from(*source).empty());
  const std::vector<std::string> remarks = source->remarks();
  ASSERT_EQ(remarks.size(), 1U);
  EXPECT_NE(remarks.front().find("at most 50 ms apart"), std::string::npos) << remarks.front();
  EXPECT_NE(remarks.front().find("table"), std::string::npos) << remarks.front();
}

TEST(ScipSession, SingleScansAreNoPartOfTheSweepsOfLines) {
  SessionWriter session;
  for (int i = 0; i < 3; ++i) {
    session.single();
    session.pass(1'000);
  }
  // The first line comes a second after the last single scan, in a sweep of its own.
  session.pass(-25);
  session.lines(6);
  session.single();
  session.lines(10);
  ScipSourceConfig config;
  config.spinning.turns = false;
  const auto source = sweeps_of_session(session.path(), {}, config);
  const std::vector<DecodedSweep> sweeps = sweeps_from(*source);
  ASSERT_EQ(sweeps.size(), 7U);
  for (std::size_t i = 0; i < sweeps.size(); ++i) {
    SCOPED_TRACE(i);
    EXPECT_EQ(sweeps[i].packets, i < 3 ? 1U : 4U);
    EXPECT_EQ(sweeps[i].packets_lost, 0U);
    EXPECT_EQ(sweeps[i].complete, i >= 3);
    EXPECT_EQ(sweeps[i].period_ns, 100'000'000U);
    ASSERT_FALSE(sweeps[i].points.empty());
    EXPECT_LT(sweeps[i].points.back().time_ns, 100'000'000U);
  }
  std::uint64_t left_out = 0;
  for (const auto& [name, count] : source->counts()) {
    if (name == "single_scans_left_out") left_out = count;
  }
  EXPECT_EQ(left_out, 1U);
}

TEST(ScipSession, ALiveScannersLinesNameTheTimeTheyWait) {
  const std::string text = no_angles_text(true);
  EXPECT_NE(text.find("at most 50 ms apart"), std::string::npos) << text;
  EXPECT_NE(text.find("a line waits 1000 ms"), std::string::npos) << text;
  EXPECT_NE(text.find("lidar/<sensor>/angle"), std::string::npos) << text;
}

}  // namespace
}  // namespace zloam::driver
