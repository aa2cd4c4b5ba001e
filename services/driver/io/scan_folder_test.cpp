#include "driver/io/scan_folder.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <numeric>
#include <random>

#include "driver/io/test_sources.hpp"

namespace zloam::driver {
namespace {

using test::Bytes;
using test::Sources;
using ::testing::DoubleNear;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::Not;

TEST_F(Sources, ScanFoldersRefuseWhatTheyCannotRead) {
  const ScanTiming timing{TimeModel::kClockwise, 0.1, 180.0};
  const std::string missing = (folder_ / "missing").string();
  EXPECT_THAT(error_of([&] { open_kitti(missing, timing); }), HasSubstr(missing));
  EXPECT_THAT(error_of([&] { open_kitti(folder_.string(), timing); }), HasSubstr("no scans"));
  EXPECT_THAT(error_of([&] { open_synth(folder_.string()); }), HasSubstr("scans"));
  write("velodyne/000000.bin", Bytes(32, 0));
  EXPECT_THAT(error_of([&] { open_kitti(folder_.string(), {}); }), HasSubstr("time_model"));
  EXPECT_THAT(error_of([&] { open_kitti(folder_.string(), timing); }), HasSubstr("not one return"));
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

/// They fit neither as nanoseconds nor as seconds into 64 bits.
TEST_F(Sources, NumbersInNamesThatAreTooLargeForTimesAreNone) {
  Bytes scan(16, 0);
  scan[3] = 0x3F;  // x = 0.5
  const std::vector<std::vector<std::string>> folders = {
      {"9500000000000000001", "9700000000000000003"}, {"9300000001", "9999999990"}};
  for (const std::vector<std::string>& names : folders) {
    for (const std::string& name : names) write(names[0] + "/" + name + ".bin", scan);
    const auto scans =
        open_kitti((folder_ / names[0]).string(), {TimeModel::kDeskewed, 0.1, 180.0});
    EXPECT_THAT(scans->remarks(), ElementsAre(HasSubstr("neither numbers of scans nor times")));
  }
}

constexpr ScanTiming kTurning{TimeModel::kClockwise, 0.1, 180.0};

using Floats = std::vector<float>;

/// A surrounding wall whose distance identifies the scan: eight rings, one after the other.
Floats scan_of(float distance_m) {
  Floats xyzi;
  for (int ring = 0; ring < 8; ++ring) {
    for (int step = 0; step < 360; ++step) {
      const double azimuth = (step + 0.5) * M_PI / 180.0;
      xyzi.insert(xyzi.end(),
                  {distance_m * static_cast<float>(std::cos(azimuth)),
                   distance_m * static_cast<float>(std::sin(azimuth)),
                   distance_m * static_cast<float>(std::tan(0.03 - 0.01 * ring)), 0.5F});
    }
  }
  return xyzi;
}

Bytes bytes_of(const Floats& floats) {
  Bytes bytes(floats.size() * sizeof(float));
  std::memcpy(bytes.data(), floats.data(), bytes.size());
  return bytes;
}

struct Seen {
  std::vector<int> distances_m;  // 0: a sweep without a return
  std::vector<double> starts_s;
  std::vector<bool> complete;
};

Seen seen_in(ScanFolder& scans) {
  Seen seen;
  DecodedSweep sweep;
  while (scans.next(sweep)) {
    const bool empty = sweep.points.empty();
    seen.distances_m.push_back(empty ? 0
                                     : static_cast<int>(std::lround(std::hypot(
                                           sweep.points.front().x, sweep.points.front().y))));
    const std::uint32_t first_ns = empty ? 0 : 138'888;
    seen.starts_s.push_back(1e-9 * static_cast<double>(sweep.stamp_ns - first_ns));
    seen.complete.push_back(sweep.complete);
  }
  return seen;
}

std::string all_of(const std::vector<std::string>& texts) {
  std::string all;
  for (const std::string& text : texts) all += text + "\n";
  return all;
}

class ScanNames : public Sources {
 protected:
  void scans(const std::vector<std::string>& names) {
    float distance_m = 10.0F;
    for (const std::string& name : names)
      write("velodyne/" + name, bytes_of(scan_of(distance_m++)));
  }
  void times(const std::string& text) { write("times.txt", Bytes(text.begin(), text.end())); }
  Seen seen() {
    const auto folder = open_kitti(folder_.string(), kTurning);
    Seen seen = seen_in(*folder);
    remarks_ = all_of(folder->remarks());
    counts_ = folder->counts();
    return seen;
  }
  std::uint64_t count(std::string_view name) const {
    for (const auto& [key, value] : counts_) {
      if (key == name) return value;
    }
    return 0;
  }
  std::string refused() {
    return error_of([&] { open_kitti(folder_.string(), kTurning); });
  }

  std::string remarks_;
  NamedCounts counts_;
};

TEST_F(ScanNames, GoByTheirNumbers) {
  scans({"0.bin", "1.bin", "2.bin", "3.bin", "4.bin", "5.bin", "6.bin", "7.bin", "8.bin", "9.bin",
         "10.bin", "11.bin"});
  const Seen got = seen();
  EXPECT_THAT(got.distances_m, ElementsAre(10, 11, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21));
  for (std::size_t i = 0; i < 12; ++i) EXPECT_NEAR(got.starts_s[i], 0.1 * i, 1e-4);
  EXPECT_EQ(remarks_, "");
}

TEST_F(ScanNames, NumbersStandAnywhereInTheName) {
  scans({"scan_8_a.bin", "scan_9_a.bin", "scan_10_a.bin"});
  EXPECT_THAT(seen().distances_m, ElementsAre(10, 11, 12));
}

TEST_F(ScanNames, NamesOfAnyOtherKindGoInTheOrderOfThePeopleWhoNamedThem) {
  scans({"lot a2.bin", "lot a10.bin", "lot b1.bin"});
  EXPECT_THAT(seen().distances_m, ElementsAre(10, 11, 12));
}

TEST_F(ScanNames, ThatAreTimesGiveTheTimes) {
  scans({"9.95.bin", "10.05.bin", "10.15.bin", "10.4.bin", "10.5.bin"});
  const Seen got = seen();
  EXPECT_THAT(got.distances_m, ElementsAre(10, 11, 12, 13, 14));
  EXPECT_THAT(got.starts_s,
              ElementsAre(DoubleNear(9.95, 1e-4), DoubleNear(10.05, 1e-4), DoubleNear(10.15, 1e-4),
                          DoubleNear(10.4, 1e-4), DoubleNear(10.5, 1e-4)));
  std::filesystem::remove_all(folder_);
  scans({"1317617735034000000.bin", "1317617735134000000.bin", "1317617735234000000.bin"});
  EXPECT_NEAR(seen().starts_s[2], 1317617735.234, 1e-4);
}

TEST_F(ScanNames, HiddenFilesAreNoScans) {
  scans({"000000.bin", "000001.bin"});
  write("velodyne/._000000.bin", Bytes(4096, 7));
  write("velodyne/.000001.bin", Bytes(4096, 7));
  EXPECT_THAT(seen().distances_m, ElementsAre(10, 11));
  EXPECT_EQ(count("files_hidden"), 2U);
}

TEST_F(ScanNames, AMissingNumberIsAnEmptySweepAndSaid) {
  scans({"000007.bin", "000008.bin", "000011.bin", "000012.bin"});
  const Seen got = seen();
  EXPECT_THAT(got.distances_m, ElementsAre(10, 11, 0, 0, 12, 13));
  EXPECT_NEAR(got.starts_s[4], 0.4, 1e-4);
  EXPECT_THAT(remarks_, HasSubstr("9 to 10"));
}

TEST_F(ScanNames, OneNumberTwiceIsRefused) {
  scans({"1.bin", "01.bin"});
  EXPECT_THAT(refused(), HasSubstr("01.bin"));
}

TEST_F(ScanNames, TimesGoByTheNumbers) {
  scans({"000001.bin", "000002.bin", "000004.bin"});
  times("5.0\n5.1\n5.2\n5.3\n5.4\n5.5\n");
  EXPECT_NEAR(seen().starts_s[3], 5.4, 1e-4);
  times("5.1\n5.2\n5.4\n");
  EXPECT_NEAR(seen().starts_s[3], 5.4, 1e-4) << "one for each scan that is there";
  EXPECT_NEAR(seen().starts_s[2], 5.3, 1e-4);
  times("5.0\n5.1\n");
  EXPECT_THAT(refused(), HasSubstr("2 times for 3 scans"));
  times("5.1\n5.3\n5.2\n");
  EXPECT_THAT(refused(), HasSubstr("times.txt:3"));
  times("5.1\n5.2 s\n5.3\n");
  EXPECT_THAT(refused(), HasSubstr("times.txt:2"));
  times("5100\n5200\n5400\n");
  EXPECT_THAT(refused(), HasSubstr("no seconds"));
  times("\xEF\xBB\xBF# begin\r\n5.1\r\n5.2\r\n5.4\r\n");
  EXPECT_NEAR(seen().starts_s[3], 5.4, 1e-4);
}

TEST_F(ScanNames, WhatTheirNamesSayOfTheTimesIsSaidOnlyWithoutAFileOfTimes) {
  const std::vector<std::pair<std::vector<std::string>, std::string>> cases = {
      {{"5.bin", "100.bin", "1000.bin"}, "neither numbers of scans nor times"},
      {{"2.bin", "4.bin", "6.bin"}, "go up by 2"}};
  for (const auto& [names, remark] : cases) {
    SCOPED_TRACE(remark);
    std::filesystem::remove_all(folder_);
    scans(names);
    seen();
    EXPECT_THAT(remarks_, HasSubstr(remark));
    times("5.1\n5.2\n5.3\n");
    EXPECT_NEAR(seen().starts_s[2], 5.3, 1e-4);
    EXPECT_EQ(remarks_, "");
  }
}

TEST_F(ScanNames, OfADamagedScanWhatIsWholeIsUsed) {
  scans({"0.bin", "1.bin", "2.bin", "3.bin"});
  Bytes cut = bytes_of(scan_of(11.0F));
  cut.resize(20'007);
  write("velodyne/1.bin", cut);
  write("velodyne/2.bin", {});
  const Seen got = seen();
  EXPECT_THAT(got.distances_m, ElementsAre(10, 11, 0, 13));
  EXPECT_THAT(got.complete, ElementsAre(true, false, false, true));
  EXPECT_EQ(count("scans_cut"), 2U);
  EXPECT_THAT(remarks_, HasSubstr("1.bin: its 20007 bytes"));
  EXPECT_THAT(remarks_, HasSubstr("2.bin: is empty"));
}

TEST_F(ScanNames, AMissingScanIsNotComplete) {
  scans({"0.bin", "1.bin", "3.bin"});
  const Seen got = seen();
  EXPECT_THAT(got.distances_m, ElementsAre(10, 11, 0, 12));
  EXPECT_THAT(got.complete, ElementsAre(true, true, false, true));
}

TEST_F(ScanNames, TenDamagedScansAreNamedAndMoreAreSummedUp) {
  std::vector<std::string> names{"00.bin"};
  for (int i = 1; i <= 11; ++i) names.push_back((i < 10 ? "0" : "") + std::to_string(i) + ".bin");
  scans(names);
  for (int i = 1; i <= 10; ++i) write("velodyne/" + names[static_cast<std::size_t>(i)], {});
  seen();
  EXPECT_THAT(remarks_, HasSubstr("10.bin: is empty"));
  EXPECT_THAT(remarks_, Not(HasSubstr("further scans")));
  write("velodyne/11.bin", {});
  seen();
  EXPECT_THAT(remarks_, HasSubstr("further scans are not whole"));
}

TEST_F(ScanNames, WhatNoLidarSawIsRefused) {
  const auto refused_as = [&](const Floats& floats) {
    write("0.bin", bytes_of(floats));
    return refused();
  };
  Floats scan = scan_of(10.0F);
  Floats millimetres = scan;
  for (std::size_t i = 0; i < scan.size(); ++i) millimetres[i] *= i % 4 == 3 ? 1.0F : 1000.0F;
  EXPECT_THAT(refused_as(millimetres), HasSubstr("metres"));

  Floats five;
  for (std::size_t i = 0; i < scan.size(); ++i) {
    five.push_back(scan[i]);
    if (i % 4 == 3) five.push_back(static_cast<float>(i / 4 % 64));
  }
  EXPECT_THAT(refused_as(five), HasSubstr("5 floats"));

  std::vector<std::size_t> order(scan.size() / 4);
  std::iota(order.begin(), order.end(), std::size_t{0});
  const auto reordered = [&] {
    Floats floats;
    for (const std::size_t i : order) {
      floats.insert(floats.end(), scan.begin() + static_cast<std::ptrdiff_t>(4 * i),
                    scan.begin() + static_cast<std::ptrdiff_t>(4 * i + 4));
    }
    return floats;
  };
  std::stable_sort(order.begin(), order.end(),
                   [](std::size_t a, std::size_t b) { return a % 360 < b % 360; });
  EXPECT_THAT(refused_as(reordered()), HasSubstr("ring by ring"));
  std::shuffle(order.begin(), order.end(), std::mt19937(1));
  EXPECT_THAT(refused_as(reordered()), HasSubstr("rings"));
  EXPECT_EQ(refused_as(scan), "no error");
}

}  // namespace
}  // namespace zloam::driver
