// Recordings that another program reads, with a script in its place.

#include "driver/io/recording.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstring>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "driver/io/sweep_source.hpp"
#include "driver/io/test_sources.hpp"
#include "driver/scan/plausible.hpp"

namespace zloam::driver {
namespace {

using test::Bytes;
using test::Sources;
using ::testing::HasSubstr;

void append(Bytes& bytes, const void* data, std::size_t size) {
  const auto* const at = static_cast<const std::uint8_t*>(data);
  bytes.insert(bytes.end(), at, at + size);
}

void frame(Bytes& bytes, FrameKind kind, const void* data, std::size_t size) {
  FrameHead head{{'Z', 'L', 'R', 'C'}, static_cast<std::uint32_t>(kind), size};
  append(bytes, &head, sizeof head);
  append(bytes, data, size);
}

/// A cloud whose returns are all this far away.
void cloud(Bytes& bytes, std::int64_t stamp_ns, float range_m) {
  Bytes data;
  const RecordedSweep about{stamp_ns, 100'000'000, 1, 1, 1};
  append(data, &about, sizeof about);
  const Point point{range_m, 0.0F, 0.0F, 0.0F, 0, 0, ReturnType::kStrongest, 0};
  for (std::size_t i = 0; i < kJudgedReturns; ++i) append(data, &point, sizeof point);
  frame(bytes, FrameKind::kSweep, data.data(), data.size());
}

TEST_F(Sources, OfManySpoiltCloudsTheFirstAreNamedAndAllAreCounted) {
  constexpr std::uint64_t kSpoilt = 300;
  constexpr std::string_view kIdentity = "clouds of a test";
  Bytes frames;
  frame(frames, FrameKind::kIdentity, kIdentity.data(), kIdentity.size());
  cloud(frames, 1, 10.0F);
  // Something lies on the sensor: each cloud has its own small range.
  for (std::uint64_t i = 0; i < kSpoilt; ++i) {
    cloud(frames, static_cast<std::int64_t>(i + 2), 0.01F + 1e-5F * static_cast<float>(i));
  }
  frame(frames, FrameKind::kEnd, nullptr, 0);
  write("frames", frames);
  const std::string script = "#!/bin/sh\nexec cat '" + (folder_ / "frames").string() + "'\n";
  write("reader", Bytes(script.begin(), script.end()));
  std::filesystem::permissions(folder_ / "reader", std::filesystem::perms::owner_all);

  RecordingOptions options;
  options.path = "drive.bag";
  options.reader = (folder_ / "reader").string();
  const Recording recording = open_recording(options);
  DecodedSweep sweep;
  while (recording.clouds->next(sweep)) continue;
  EXPECT_EQ(zloam::driver::count_of(recording.clouds->counts(), "scans"), kSpoilt + 1);
  EXPECT_EQ(zloam::driver::count_of(recording.clouds->counts(), "scans_spoilt"), kSpoilt);
  const std::vector<std::string> remarks = recording.clouds->remarks();
  ASSERT_EQ(remarks.size(), 11U);
  EXPECT_THAT(remarks.front(), HasSubstr("the cloud is left out"));
  EXPECT_THAT(remarks.back(), HasSubstr("further clouds"));
}

}  // namespace
}  // namespace zloam::driver
