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

TEST(ScipSession, ALiveScannersLinesNameTheTimeTheyWait) {
  const std::string text = no_angles_text(true);
  EXPECT_NE(text.find("at most 50 ms apart"), std::string::npos) << text;
  EXPECT_NE(text.find("a line waits 1000 ms"), std::string::npos) << text;
  EXPECT_NE(text.find("lidar/<sensor>/angle"), std::string::npos) << text;
}

}  // namespace
}  // namespace zloam::driver
