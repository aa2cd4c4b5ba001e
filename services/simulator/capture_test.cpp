#include "simulator/capture.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdio>
#include <map>
#include <set>
#include <sstream>

#include "simulator/calendar.hpp"
#include "simulator/faults.hpp"
#include "simulator/io/parallel.hpp"
#include "simulator/scenes.hpp"

namespace zloam::simulator {
namespace {

constexpr std::int64_t kEpochNs = 1'704'067'210'000'000'000;

std::uint32_t little32(const std::vector<std::uint8_t>& b, std::size_t at) {
  return b[at] + 256U * b[at + 1] + 65536U * b[at + 2] + 16777216U * b[at + 3];
}

std::uint32_t big16(const std::vector<std::uint8_t>& b, std::size_t at) {
  return 256U * b[at] + b[at + 1];
}

std::vector<Datagram> some_datagrams(std::int64_t count) {
  std::vector<Datagram> out;
  for (std::int64_t i = 0; i < count; ++i) {
    out.push_back({kEpochNs + i * 1'327'104, vlp16::kDataPort, i,
                   std::vector<std::uint8_t>(vlp16::kDataBytes, static_cast<std::uint8_t>(i))});
  }
  return out;
}

/// All datagrams that come out, including those held back until the end.
std::vector<Datagram> all_of(FaultInjector& faults, const std::vector<Datagram>& in) {
  auto out = faults.pass(in);
  const auto rest = faults.flush();
  out.insert(out.end(), rest.begin(), rest.end());
  return out;
}

TEST(Pcap, RecordHasCorrectHeaders) {
  Datagram datagram{kEpochNs + 123'456'789, vlp16::kPositionPort, 0,
                    std::vector<std::uint8_t>(512, 7)};
  for (const bool nano : {false, true}) {
    const auto header = pcap_header(nano);
    ASSERT_EQ(header.size(), 24U);
    EXPECT_EQ(little32(header, 0), nano ? 0xA1B23C4DU : 0xA1B2C3D4U);
    EXPECT_EQ(little32(header, 20), 1U);
    std::vector<std::uint8_t> record;
    append_pcap_record(datagram, nano, record);
    ASSERT_EQ(record.size(), 16U + 42U + 512U);
    EXPECT_EQ(little32(record, 0), 1'704'067'210U);
    EXPECT_EQ(little32(record, 4), nano ? 123'456'789U : 123'456U);
    EXPECT_EQ(little32(record, 8), 554U);
    EXPECT_EQ(little32(record, 12), 554U);
    EXPECT_EQ(big16(record, 16 + 12), 0x0800U);
    EXPECT_EQ(record[16 + 14], 0x45);
    EXPECT_EQ(big16(record, 16 + 16), 540U);
    EXPECT_EQ(record[16 + 23], 17);
    // The sum of all words of the header, including the checksum, must be 0xFFFF.
    std::uint32_t sum = 0;
    for (std::size_t i = 0; i < 20; i += 2) {
      sum += big16(record, 30 + i);
    }
    sum = (sum & 0xFFFF) + (sum >> 16);
    EXPECT_EQ((sum & 0xFFFF) + (sum >> 16), 0xFFFFU);
    EXPECT_EQ(big16(record, 50 + 2), 8308U);
    EXPECT_EQ(big16(record, 50 + 4), 520U);
    EXPECT_EQ(record[58], 7);
  }
}

TEST(Datagrams, OnePositionPacketForFourteenDataPackets) {
  SimulationConfig config;
  const Sensor sensor(make_scene("tunnel", {}), config);
  const auto packets = data_packets(sensor, 0, 140, 2);
  const auto sent = datagrams(sensor, 0, packets);
  EXPECT_EQ(std::count_if(sent.begin(), sent.end(), [](const Datagram& d) { return d.is_data(); }),
            140);
  EXPECT_EQ(sent.size(), 150U);
  EXPECT_TRUE(std::is_sorted(sent.begin(), sent.end(), [](const Datagram& a, const Datagram& b) {
    return a.sent_ns < b.sent_ns;
  }));
  // A packet is sent only after its last firing.
  EXPECT_GT(sent.front().sent_ns, config.epoch_ns + 1'306'368);
  for (const Datagram& datagram : sent) {
    EXPECT_EQ(datagram.payload.size(), datagram.is_data() ? 1206U : 512U);
  }
}

TEST(Tum, KeepsNanoseconds) {
  Pose pose = Pose::Identity();
  pose.translation() = Eigen::Vector3d(1.5, -2.25, 3.0);
  EXPECT_EQ(tum_line(1'704'067'210'000'000'007, pose),
            "1704067210.000000007 1.500000000 -2.250000000 3.000000000 "
            "0.000000000000 0.000000000000 0.000000000000 1.000000000000\n");
}

TEST(Utc, ReadsWhatItShouldAndRefusesTheRest) {
  EXPECT_EQ(parse_utc("2024-01-01T00:00:10"), kEpochNs);
  EXPECT_EQ(parse_utc("2024-01-01T00:59:59.999500Z"), 1'704'070'799'999'500'000);
  for (const char* wrong : {"", "2024-01-01", "2024-13-01T00:00:00", "2024-01-01T24:00:00",
                            "2024-01-01T00:00:60", "2024-01-01T00:00:10 UTC"}) {
    EXPECT_THROW(parse_utc(wrong), std::invalid_argument) << wrong;
  }
}

TEST(Calendar, DaysAndDatesAreInverse) {
  EXPECT_EQ(days_from_date({1970, 1, 1}), 0);
  EXPECT_EQ(days_from_date({2000, 3, 1}), 11017);
  EXPECT_EQ(days_from_date({2024, 1, 1}), 19723);
  int month_lengths = 0;
  for (std::int64_t day = -200'000; day < 200'000; ++day) {
    const Date date = date_from_days(day);
    ASSERT_EQ(days_from_date(date), day);
    const Date next = date_from_days(day + 1);
    ASSERT_TRUE(next.day == date.day + 1 || next.day == 1);
    month_lengths += next.day == 1 ? date.day : 0;
  }
  EXPECT_NEAR(month_lengths, 400'000, 31);
  EXPECT_TRUE(is_date({2024, 2, 29}));
  EXPECT_FALSE(is_date({2023, 2, 29}));
  EXPECT_FALSE(is_date({2024, 4, 31}));
}

TEST(Faults, NothingAskedForNothingDone) {
  FaultInjector faults({}, kEpochNs);
  const auto in = some_datagrams(50);
  const auto out = faults.pass(in);
  ASSERT_EQ(out.size(), in.size());
  for (std::size_t i = 0; i < in.size(); ++i) {
    EXPECT_EQ(out[i].payload, in[i].payload);
  }
  EXPECT_TRUE(faults.log().empty());
}

TEST(Faults, LogAccountsForEveryPacket) {
  FaultConfig config;
  config.loss = 0.1;
  config.duplication = 0.1;
  config.delay = 0.1;
  config.corruption = 0.1;
  config.wrong_length = 0.1;
  FaultInjector faults(config, kEpochNs);
  const auto in = some_datagrams(2000);
  const auto out = all_of(faults, in);
  std::map<std::int64_t, std::set<std::string>> log;
  std::map<std::string, int> counts;
  for (const Fault& fault : faults.log()) {
    log[fault.index].insert(fault.kind);
    ++counts[fault.kind];
  }
  for (const auto& [kind, count] : counts) {
    const auto kinds = fault_kinds();
    EXPECT_NE(std::find(kinds.begin(), kinds.end(), kind), kinds.end()) << kind;
  }
  for (const char* kind : {"lost", "duplicated", "late", "corrupted", "cut"}) {
    EXPECT_NEAR(counts[kind], 180, 60) << kind;
  }
  std::map<std::int64_t, int> seen;
  std::int64_t newest = -1;
  for (const Datagram& datagram : out) {
    const auto& done = log[datagram.index];
    ++seen[datagram.index];
    EXPECT_EQ(datagram.payload.size() != vlp16::kDataBytes, done.contains("cut"));
    EXPECT_EQ(!done.contains("cut") &&
                  datagram.payload != in[static_cast<std::size_t>(datagram.index)].payload,
              !done.contains("cut") && done.contains("corrupted"));
    EXPECT_EQ(datagram.index < newest, done.contains("late")) << datagram.index;
    newest = std::max(newest, datagram.index);
  }
  for (std::int64_t i = 0; i < 2000; ++i) {
    const auto& done = log[i];
    EXPECT_EQ(seen[i], done.contains("lost") ? 0 : done.contains("duplicated") ? 2 : 1) << i;
  }
}

TEST(Faults, ClockStepsAndGapsHappenWhereTheyShould) {
  FaultConfig config;
  // The step at 0.1 s takes the stamps below the full hour, so that they wrap; the step at 0.15 s
  // adds to it.
  config.clock_steps = {{0.15, 7.25}, {0.1, -30.0}};
  config.gap_start_s = 0.05;
  config.gap_s = 0.02;
  FaultInjector faults(config, kEpochNs);
  std::vector<Datagram> in = some_datagrams(150);
  for (Datagram& datagram : in) {
    vlp16::DataBytes bytes{};
    vlp16::set_stamp(bytes, datagram.sent_ns);
    datagram.payload.assign(bytes.begin(), bytes.end());
  }
  const auto out = faults.pass(in);
  EXPECT_EQ(in.size() - out.size(), 15U);
  for (const Datagram& datagram : out) {
    const double t = static_cast<double>(datagram.sent_ns - kEpochNs) * 1e-9;
    EXPECT_TRUE(t < 0.05 || t >= 0.07);
    const std::int64_t plain = 10'000'000 + (datagram.sent_ns - kEpochNs) / 1000;
    const std::int64_t first = t < 0.1 ? 0 : 3'570'000'000;
    const std::int64_t second = t < 0.15 ? 0 : 7'250'000;
    EXPECT_EQ(little32(datagram.payload, 1200), plain + first + second);
  }
  std::vector<std::int64_t> steps;
  for (const Fault& fault : faults.log()) {
    if (fault.kind == "clock_step") {
      steps.push_back(fault.index);
    } else {
      EXPECT_EQ(fault.kind, "gap");
    }
  }
  EXPECT_EQ(steps, (std::vector<std::int64_t>{76, 114}));  // 0.1 s and 0.15 s / 1.327104 ms
}

int azimuth_of(const std::vector<std::uint8_t>& payload, std::size_t block) {
  return payload[100 * block + 2] + 256 * payload[100 * block + 3];
}

TEST(Faults, BytesAreWrongWhereTheLogSays) {
  FaultConfig config;
  config.bad_flag = 0.2;
  config.azimuth_jump = 0.2;
  config.corruption = 0.2;
  FaultInjector faults(config, kEpochNs);
  std::vector<Datagram> in = some_datagrams(500);
  for (Datagram& datagram : in) {
    vlp16::DataBytes bytes = vlp16::empty_packet(ReturnMode::kStrongest);
    for (int block = 0; block < vlp16::kBlocks; ++block) {
      vlp16::set_azimuth(bytes, block, 357.0 + 0.4 * block);
    }
    datagram.payload.assign(bytes.begin(), bytes.end());
  }
  const auto out = faults.pass(in);
  ASSERT_EQ(out.size(), in.size());
  std::vector<std::vector<std::uint8_t>> expected;
  for (const Datagram& datagram : in) {
    expected.push_back(datagram.payload);
  }
  std::set<std::pair<std::int64_t, std::size_t>> noisy;
  int jumps = 0;
  for (const Fault& fault : faults.log()) {
    auto& payload = expected[static_cast<std::size_t>(fault.index)];
    std::size_t block = 0;
    int by = 0;
    if (std::sscanf(fault.detail.c_str(), "block %zu by %d", &block, &by) == 2) {
      ASSERT_EQ(fault.kind, "azimuth_jump");
      ASSERT_GE(by, 100);
      ++jumps;
      for (; block < 12; ++block) {
        const int off = (azimuth_of(payload, block) + by) % 36000;
        payload[100 * block + 2] = static_cast<std::uint8_t>(off);
        payload[100 * block + 3] = static_cast<std::uint8_t>(off / 256);
      }
    } else if (fault.kind == "bad_flag") {
      ASSERT_EQ(std::sscanf(fault.detail.c_str(), "block %zu", &block), 1);
      noisy.insert({fault.index, 100 * block});
    } else {
      ASSERT_EQ(fault.kind, "corrupted");
      std::istringstream places(fault.detail.substr(6));
      for (std::size_t at = 0; places >> at;) {
        noisy.insert({fault.index, at});
      }
    }
  }
  EXPECT_GT(jumps, 50);
  EXPECT_GT(noisy.size(), 800U);
  std::size_t changed = 0;
  for (const auto& [packet, at] : noisy) {
    const auto i = static_cast<std::size_t>(packet);
    changed += out[i].payload[at] != expected[i][at] ? 1U : 0U;
  }
  EXPECT_GE(changed + 5, noisy.size()) << "two faults of one byte may cancel each other, no more";
  for (std::size_t i = 0; i < out.size(); ++i) {
    for (std::size_t at = 0; at < 1206; ++at) {
      const bool same = out[i].payload[at] == expected[i][at];
      // Several faults can hit one byte, a flag twice for example, so a byte named in the log
      // may have any value; every other byte must be as expected.
      ASSERT_TRUE(same || noisy.contains({static_cast<std::int64_t>(i), at})) << i << " " << at;
    }
  }
}

TEST(Faults, LatePacketsComeAfterAsManyAsTheLogSays) {
  FaultConfig config;
  config.loss = 0.05;
  config.duplication = 0.05;
  config.delay = 0.2;
  config.delay_packets = 6;
  config.seed = 4;
  FaultInjector faults(config, kEpochNs);
  const auto out = all_of(faults, some_datagrams(801));
  std::map<std::int64_t, int> overtaken;
  for (const Fault& fault : faults.log()) {
    int by = 0;
    if (std::sscanf(fault.detail.c_str(), "by %d", &by) == 1) {
      overtaken[fault.index] = by;
    }
  }
  EXPECT_GT(overtaken.size(), 100U);
  std::set<std::int64_t> sent;
  int shorter = 0;
  for (const Datagram& datagram : out) {
    const auto later = std::count_if(sent.upper_bound(datagram.index), sent.end(),
                                     [&](std::int64_t i) { return !overtaken.contains(i); });
    EXPECT_EQ(later, overtaken.contains(datagram.index) ? overtaken[datagram.index] : 0);
    shorter += overtaken.contains(datagram.index) && later < 6 ? 1 : 0;
    sent.insert(datagram.index);
  }
  EXPECT_LE(shorter, 6) << "only what was held back at the end";
}

TEST(Faults, RefusesImpossibleParts) {
  FaultConfig config;
  config.loss = 1.5;
  EXPECT_THROW(FaultInjector(config, 0), std::invalid_argument);
  config.loss = 0.0;
  config.delay_packets = 0;
  EXPECT_THROW(FaultInjector(config, 0), std::invalid_argument);
}

}  // namespace
}  // namespace zloam::simulator
