#include "driver/io/scan_folder.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "driver/io/test_sources.hpp"

namespace zloam::driver {
namespace {

using test::Bytes;
using test::Sources;
using ::testing::HasSubstr;

TEST_F(Sources, ScanFoldersRefuseWhatTheyCannotRead) {
  const ScanTiming timing{TimeModel::kClockwise, 0.1, 180.0};
  const std::string missing = (folder_ / "missing").string();
  EXPECT_THAT(error_of([&] { open_kitti(missing, timing); }), HasSubstr(missing));
  EXPECT_THAT(error_of([&] { open_kitti(folder_.string(), timing); }), HasSubstr("no scans"));
  EXPECT_THAT(error_of([&] { open_synth(folder_.string()); }), HasSubstr("scans"));
  write("velodyne/000000.bin", Bytes(32, 0));
  write("velodyne/000001.bin", Bytes(17, 0));
  EXPECT_THAT(error_of([&] { open_kitti(folder_.string(), {}); }), HasSubstr("time_model"));
  const auto scans = open_kitti(folder_.string(), timing);
  DecodedSweep sweep;
  EXPECT_TRUE(scans->next(sweep));
  EXPECT_THAT(error_of([&] { scans->next(sweep); }), HasSubstr("000001.bin"));
}

TEST_F(Sources, ScanFoldersReadInOrderWithTheirTimes) {
  Bytes scan(16, 0);
  scan[3] = 0x3F;  // x = 0.5
  scan[2] = 0x00;
  write("velodyne/000001.bin", scan);
  write("velodyne/000000.bin", scan);
  const std::string times = "100.5\n100.6\n";
  write("times.txt", Bytes(times.begin(), times.end()));
  const auto scans = open_kitti(folder_.string(), {TimeModel::kDeskewed, 0.1, 180.0});
  DecodedSweep sweep;
  ASSERT_TRUE(scans->next(sweep));
  EXPECT_EQ(sweep.stamp_ns, 100'500'000'000);
  ASSERT_TRUE(scans->next(sweep));
  EXPECT_EQ(sweep.stamp_ns, 100'600'000'000);
  EXPECT_FALSE(scans->next(sweep));

  write("scans/000000.bin", scan);
  EXPECT_THAT(error_of([&] { open_synth(folder_.string()); }), HasSubstr("stamps.txt"));
  const std::string stamps = "5.0 5.1\n";
  write("stamps.txt", Bytes(stamps.begin(), stamps.end()));
  const auto synth = open_synth(folder_.string());
  ASSERT_TRUE(synth->next(sweep));
  EXPECT_EQ(sweep.stamp_ns, 5'000'000'000);
  EXPECT_EQ(sweep.period_ns, 100'000'000U);
  EXPECT_FALSE(synth->next(sweep));
}

}  // namespace
}  // namespace zloam::driver
