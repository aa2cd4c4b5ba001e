// Worked examples of the protocol: replies with every byte and value known, made by the rules of
// Hokuyo's C-42-03320B and decoded identically by two other implementations.

#include <gtest/gtest.h>

#include <numbers>

#include "driver/scip/encoding.hpp"
#include "driver/scip/replies.hpp"
#include "driver/scip/reply_reader.hpp"
#include "driver/scip/scan.hpp"

namespace zloam::driver::scip {
namespace {

std::span<const std::uint8_t> bytes_of(std::string_view text) {
  return {reinterpret_cast<const std::uint8_t*>(text.data()), text.size()};
}

RawReply only_reply(std::string_view text) {
  ReplyReader reader;
  reader.add(bytes_of(text), 7);
  const auto reply = reader.take();
  EXPECT_TRUE(reply.has_value());
  EXPECT_FALSE(reader.take().has_value());
  return reply.value_or(RawReply{});
}

Scan only_scan(std::string_view text) {
  const RawReply reply = only_reply(text);
  Scan scan;
  const auto head = head_of(reply);
  EXPECT_TRUE(head.has_value());
  EXPECT_EQ(read_scan(reply, *head, scan), ScanError::kNone);
  return scan;
}

std::vector<std::uint32_t> ranges(const Scan& scan) {
  std::vector<std::uint32_t> all;
  for (const Echo& echo : scan.echoes) all.push_back(echo.range_mm);
  return all;
}

std::vector<std::uint32_t> intensities(const Scan& scan) {
  std::vector<std::uint32_t> all;
  for (const Echo& echo : scan.echoes) all.push_back(echo.intensity);
  return all;
}

std::vector<int> echoes_by_step(const Scan& scan) {
  std::vector<int> counts;
  for (const Echo& echo : scan.echoes) {
    if (echo.number == 0) counts.push_back(0);
    ++counts.back();
  }
  return counts;
}

constexpr std::string_view kParameters =
    "PP\n00P\nMODL:UTM-30LX-EW;I\nDMIN:23;7\nDMAX:60000;J\nARES:1440;^\nAMIN:0;?\nAMAX:1080;Z\n"
    "AFRT:540;0\nSCAN:2400;U\n\n";
constexpr std::string_view kDistances = "GD0538054201\n00P\n_65>8\n0?X00G001ooo7D`W\n\n";
constexpr std::string_view kIntensities =
    "GE0538054901\n00P\n_65WQ\n0?X07d0@=0;70@b0>J0AG0A]0Al0E00BQ0HC0C60KV0C[0Ni0D@0R<0De0UO0EJ0^\n"
    "Xb0Eo0\\5O\n\n";
constexpr std::string_view kEchoes = "HD0538054201\n00P\n00000\n0O@0^h&1m00010nP&1>8&1M`005>\n\n";
constexpr std::string_view kEchoesWithIntensities =
    "HE0538054701\n00P\nooool\n0O@01T0^h038&1m002F0010000nP04\\&1>8038&1M`01T1]H00b1]I00c1]J00d1@"
    "\n]K00e1]L00f1]M00g_\n\n";

TEST(ScipEncoding, ValuesOfTheManual) {
  EXPECT_EQ(decode("CB"), 1234U);
  EXPECT_EQ(decode("1Dh"), 5432U);
  EXPECT_EQ(decode("m2@0"), 16000000U);
  EXPECT_EQ(decode("ooo"), 262143U);
  EXPECT_EQ(decode("0&0"), std::nullopt);
  EXPECT_EQ(decode("p00"), std::nullopt);
  EXPECT_EQ(decode(""), std::nullopt);
  EXPECT_EQ(decode("000000"), std::nullopt);
}

TEST(ScipEncoding, ChecksumsOfStatusLines) {
  EXPECT_EQ(checksum("00"), 'P');
  EXPECT_EQ(checksum("99"), 'b');
  EXPECT_EQ(checksum("02"), 'R');
  EXPECT_EQ(checksum("01"), 'Q');
  EXPECT_EQ(checksum("10"), 'Q');
  EXPECT_EQ(checksum("0E"), 'e');
  EXPECT_EQ(checked("00P"), "00");
  EXPECT_FALSE(checked("00Q").has_value());
}

TEST(ScipEncoding, TheSemicolonMayCountOrNot) {
  EXPECT_EQ(checked_information("AMIN:0;?"), "AMIN:0");
  const std::string with = std::string("AMIN:0;") + checksum("AMIN:0;");
  EXPECT_EQ(checked_information(with), "AMIN:0");
  EXPECT_FALSE(checked_information("AMIN:1;?").has_value());
  EXPECT_FALSE(checked_information("AMIN:0?").has_value());
}

TEST(ScipVectors, LaserOn) {
  const auto head = head_of(only_reply("BM\n00P\n\n"));
  ASSERT_TRUE(head.has_value());
  EXPECT_EQ(head->command, "BM");
  EXPECT_EQ(head->status, "00");
}

TEST(ScipVectors, Parameters) {
  int damaged = 0;
  const Parameters p = parameters_of(values_of(only_reply(kParameters), damaged));
  EXPECT_EQ(damaged, 0);
  EXPECT_EQ(p.model, "UTM-30LX-EW");
  EXPECT_EQ(p.least_mm, 23U);
  EXPECT_EQ(p.most_mm, 60000U);
  EXPECT_EQ(p.steps_per_turn, 1440);
  EXPECT_EQ(p.first_step, 0);
  EXPECT_EQ(p.last_step, 1080);
  EXPECT_EQ(p.front_step, 540);
  EXPECT_EQ(p.turn_ns(), 25'000'000);
  EXPECT_DOUBLE_EQ(p.azimuth_rad(900), std::numbers::pi / 2.0);
  EXPECT_DOUBLE_EQ(p.azimuth_rad(0), -0.75 * std::numbers::pi);
  EXPECT_EQ(p.step_ns(540), 9'375'000);
}

TEST(ScipVectors, Counter) { EXPECT_EQ(counter_of(only_reply("TM1\n00P\n_65>8\n\n")), 12345678U); }

TEST(ScipVectors, ACounterInMicroseconds) {
  const std::uint64_t us = 1'700'000'000'123'456;
  std::string text;
  for (std::uint64_t rest = us; text.size() < 11; rest /= 64) {
    text.insert(text.begin(), static_cast<char>('0' + rest % 64));
  }
  EXPECT_EQ(decode_counter_ms(text), 1'700'000'000'123ULL % (1ULL << 24));
  EXPECT_EQ(decode_counter_ms("_65>"), 12345678U);
  EXPECT_FALSE(decode_counter_ms("0_65>").has_value());
  EXPECT_FALSE(decode_counter_ms("0000000000p").has_value());
}

TEST(ScipVectors, Distances) {
  const Scan scan = only_scan(kDistances);
  EXPECT_EQ(scan.counter_ms, 12345678U);
  EXPECT_EQ(scan.request.first_step, 538);
  EXPECT_EQ(ranges(scan), (std::vector<std::uint32_t>{1000, 23, 1, 262143, 30000}));
  EXPECT_EQ(scan.echoes.back().step, 542);
}

TEST(ScipVectors, AValueAcrossTwoLines) {
  const Scan scan = only_scan(kIntensities);
  EXPECT_EQ(scan.counter_ms, 12345703U);
  EXPECT_EQ(ranges(scan), (std::vector<std::uint32_t>{1000, 1037, 1074, 1111, 1148, 1185, 1222,
                                                      1259, 1296, 1333, 1370, 1407}));
  EXPECT_EQ(intensities(scan), (std::vector<std::uint32_t>{500, 711, 922, 1133, 1344, 1555, 1766,
                                                           1977, 2188, 2399, 2610, 2821}));
}

TEST(ScipVectors, SeveralEchoes) {
  const Scan scan = only_scan(kEchoes);
  EXPECT_EQ(scan.counter_ms, 0U);
  EXPECT_EQ(ranges(scan), (std::vector<std::uint32_t>{2000, 3000, 8000, 1, 4000, 5000, 6000, 5}));
  EXPECT_EQ(echoes_by_step(scan), (std::vector<int>{1, 2, 1, 3, 1}));
}

TEST(ScipVectors, SeveralEchoesWithIntensities) {
  const Scan scan = only_scan(kEchoesWithIntensities);
  EXPECT_EQ(scan.counter_ms, 16777215U);
  EXPECT_EQ(ranges(scan), (std::vector<std::uint32_t>{2000, 3000, 8000, 1, 4000, 5000, 6000, 7000,
                                                      7001, 7002, 7003, 7004, 7005}));
  EXPECT_EQ(intensities(scan),
            (std::vector<std::uint32_t>{100, 200, 150, 0, 300, 200, 100, 50, 51, 52, 53, 54, 55}));
  EXPECT_EQ(echoes_by_step(scan), (std::vector<int>{1, 2, 1, 3, 1, 1, 1, 1, 1, 1}));
}

TEST(ScipVectors, Continuous) {
  ReplyReader reader;
  reader.add(bytes_of("MD0538054201000\n00P\n\nMD0538054201000\n99b\n_65>8\n0?X00G001ooo7D`W\n\n"),
             7);
  const auto started = reader.take();
  const auto first = reader.take();
  ASSERT_TRUE(started && first);
  Scan scan;
  EXPECT_EQ(read_scan(*started, *head_of(*started), scan), ScanError::kNoScan);
  EXPECT_EQ(read_scan(*first, *head_of(*first), scan), ScanError::kNone);
  EXPECT_TRUE(scan.request.continuous);
  EXPECT_EQ(ranges(scan), (std::vector<std::uint32_t>{1000, 23, 1, 262143, 30000}));
}

TEST(ScipReader, CutAtEveryByte) {
  const std::string stream =
      std::string(kParameters) + std::string(kIntensities) + std::string(kEchoesWithIntensities);
  for (std::size_t cut = 0; cut <= stream.size(); ++cut) {
    ReplyReader reader;
    reader.add(bytes_of(std::string_view(stream).substr(0, cut)), 1);
    reader.add(bytes_of(std::string_view(stream).substr(cut)), 2);
    int replies = 0;
    while (const auto reply = reader.take()) {
      ++replies;
      ASSERT_TRUE(head_of(*reply).has_value()) << cut;
    }
    ASSERT_EQ(replies, 3) << cut;
  }
}

TEST(ScipReader, LinesMayEndInCrLf) {
  std::string text(kDistances);
  for (std::size_t at = 0; (at = text.find('\n', at)) != std::string::npos; at += 2) {
    text.replace(at, 1, "\r\n");
  }
  EXPECT_EQ(ranges(only_scan(text)), (std::vector<std::uint32_t>{1000, 23, 1, 262143, 30000}));
}

TEST(ScipReader, WhatIsTooLongIsLeftOutAndTheNextReplyRead) {
  ReplyReader reader;
  reader.add(bytes_of(std::string(100'000, 'x') + "\n" + std::string(100'000, 'y') + "\n\n"), 1);
  EXPECT_FALSE(reader.take().has_value());
  EXPECT_EQ(reader.too_long(), 1U);
  std::string lines;
  for (int i = 0; i < 5000; ++i) lines += "line\n";
  reader.add(bytes_of(lines + "\n"), 1);
  EXPECT_FALSE(reader.take().has_value());
  EXPECT_EQ(reader.too_long(), 2U);
  reader.add(bytes_of(kDistances), 1);
  EXPECT_TRUE(reader.take().has_value());
}

TEST(ScipScan, EachDamagedByteIsNoticed) {
  // A checksum of six bits detects every change of one byte by less than 64.
  const std::string good(kIntensities);
  const std::size_t data = good.find("_65WQ");
  for (std::size_t i = data; i + 2 < good.size(); ++i) {
    if (good[i] == '\n') continue;
    std::string bad = good;
    bad[i] = static_cast<char>(bad[i] ^ 0x01);
    ReplyReader reader;
    reader.add(bytes_of(bad), 1);
    const auto reply = reader.take();
    ASSERT_TRUE(reply.has_value());
    Scan scan;
    EXPECT_EQ(read_scan(*reply, *head_of(*reply), scan), ScanError::kChecksum) << i;
  }
}

TEST(ScipScan, AMissingOrFurtherStepIsRefused) {
  const auto reply = [](const std::string& data) {
    return only_reply("GD0538054201\n00P\n_65>8\n" + data + checksum(data) + "\n\n");
  };
  Scan scan;
  for (const char* data : {"0?X00G001ooo", "0?X00G001ooo7D`000", "0?X00G001ooo7D"}) {
    const RawReply raw = reply(data);
    EXPECT_EQ(read_scan(raw, *head_of(raw), scan), ScanError::kLength) << data;
  }
}

TEST(ScipScan, Clusters) {
  const std::string data = "0?X00G001";
  const RawReply raw = only_reply("GD0538054202\n00P\n_65>8\n" + data + checksum(data) + "\n\n");
  Scan scan;
  ASSERT_EQ(read_scan(raw, *head_of(raw), scan), ScanError::kNone);
  ASSERT_EQ(scan.echoes.size(), 3U);
  EXPECT_EQ(scan.echoes[2].step, 542);
}

TEST(ScipScan, RequestsThatAreNone) {
  for (const char* echo : {"GD053805420", "GD0538054", "GD05x8054201", "GD0542053801",
                           "XD0538054201", "HS0538054201", "MD0538054201"}) {
    EXPECT_FALSE(
        scan_request({std::string(echo).substr(0, 2), std::string(echo).substr(2), "", "00"})
            .has_value())
        << echo;
  }
}

TEST(ScipReplies, TheUsersStringIsApart) {
  const auto head = head_of(only_reply("VV;mine\n00P\n\n"));
  ASSERT_TRUE(head.has_value());
  EXPECT_EQ(head->command, "VV");
  EXPECT_EQ(head->user, "mine");
}

TEST(ScipReplies, ParametersThatCantBe) {
  std::map<std::string, std::string> values = {{"MODL", "X"},    {"DMIN", "23"},  {"DMAX", "60000"},
                                               {"ARES", "1440"}, {"AMIN", "0"},   {"AMAX", "1080"},
                                               {"AFRT", "540"},  {"SCAN", "2400"}};
  EXPECT_NO_THROW(parameters_of(values));
  for (const char* name : {"DMIN", "DMAX", "ARES", "AMIN", "AMAX", "AFRT", "SCAN"}) {
    auto lacking = values;
    lacking.erase(name);
    EXPECT_THROW(parameters_of(lacking), std::invalid_argument) << name;
    auto wrong = values;
    wrong[name] = "-1";
    EXPECT_THROW(parameters_of(wrong), std::invalid_argument) << name;
  }
  for (const char* const slow : {"0", "1", "159"}) {
    values["SCAN"] = slow;
    EXPECT_THROW(parameters_of(values), std::invalid_argument) << slow;
  }
  values["SCAN"] = "160";
  EXPECT_NO_THROW(parameters_of(values));
}

}  // namespace
}  // namespace zloam::driver::scip
