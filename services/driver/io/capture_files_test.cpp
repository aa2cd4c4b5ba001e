// Captures and files of bare payloads. Captures are written here byte by byte.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "driver/io/link_layer.hpp"
#include "driver/io/test_sources.hpp"

namespace zloam::driver {
namespace {

using test::Bytes;
using test::Sources;
using ::testing::HasSubstr;

void add_big16(Bytes& bytes, unsigned value) {
  bytes.push_back(static_cast<std::uint8_t>(value >> 8));
  bytes.push_back(static_cast<std::uint8_t>(value));
}

template <class T>
void add_little(Bytes& bytes, T value) {
  for (std::size_t i = 0; i < sizeof(T); ++i) {
    bytes.push_back(static_cast<std::uint8_t>(value >> (8 * i)));
  }
}

struct IpOptions {
  unsigned header_words = 5;
  unsigned fragment = 0x4000;
  unsigned protocol = 17;
  unsigned port = 2368;
};

Bytes ipv4(const Bytes& payload, const IpOptions& options = {}) {
  Bytes ip;
  ip.push_back(static_cast<std::uint8_t>(0x40 | options.header_words));
  ip.push_back(0);
  add_big16(ip, static_cast<unsigned>(4 * options.header_words + 8 + payload.size()));
  add_big16(ip, 0);
  add_big16(ip, options.fragment);
  ip.push_back(64);
  ip.push_back(static_cast<std::uint8_t>(options.protocol));
  add_big16(ip, 0);
  for (const int byte : {192, 168, 1, 201, 255, 255, 255, 255}) {
    ip.push_back(static_cast<std::uint8_t>(byte));
  }
  ip.resize(4 * options.header_words, 0);
  add_big16(ip, 2368);
  add_big16(ip, options.port);
  add_big16(ip, static_cast<unsigned>(8 + payload.size()));
  add_big16(ip, 0);
  ip.insert(ip.end(), payload.begin(), payload.end());
  return ip;
}

Bytes ethernet(const Bytes& ip, const std::vector<unsigned>& vlan_types = {}) {
  Bytes frame(12, 0xAB);
  for (const unsigned type : vlan_types) {
    add_big16(frame, type);
    add_big16(frame, 5);
  }
  add_big16(frame, 0x0800);
  frame.insert(frame.end(), ip.begin(), ip.end());
  return frame;
}

Bytes behind(Bytes header, const Bytes& ip) {
  header.insert(header.end(), ip.begin(), ip.end());
  return header;
}

constexpr std::uint32_t kMicroseconds = 0xa1b2c3d4;
constexpr std::uint32_t kNanoseconds = 0xa1b23c4d;

Bytes pcap_file(std::uint32_t magic, std::uint32_t link_type, const std::vector<Bytes>& frames) {
  Bytes file;
  add_little(file, magic);
  add_little<std::uint32_t>(file, 2 | 4 << 16);
  add_little<std::uint64_t>(file, 0);
  add_little<std::uint32_t>(file, 65535);
  add_little(file, link_type);
  std::uint32_t fraction = 7;
  for (const Bytes& frame : frames) {
    add_little<std::uint32_t>(file, 1'700'000'000);
    add_little(file, fraction++);
    add_little(file, static_cast<std::uint32_t>(frame.size()));
    add_little(file, static_cast<std::uint32_t>(frame.size()));
    file.insert(file.end(), frame.begin(), frame.end());
  }
  return file;
}

/// Little-endian pcapng: section header, one interface in microseconds, one block a frame.
Bytes pcapng_file(const std::vector<Bytes>& frames) {
  Bytes file;
  for (const std::uint32_t word : {0x0A0D0D0AU, 28U, 0x1A2B3C4DU, 1U, 0xFFFFFFFFU, 0xFFFFFFFFU, 28U,
                                   1U, 20U, 1U, 65535U, 20U}) {
    add_little(file, word);
  }
  for (const Bytes& frame : frames) {
    const auto padded = static_cast<std::uint32_t>((frame.size() + 3) / 4 * 4);
    const std::uint64_t stamp_us = 1'700'000'000'000'007;
    add_little<std::uint32_t>(file, 6);
    add_little(file, 32 + padded);
    add_little<std::uint32_t>(file, 0);
    add_little(file, static_cast<std::uint32_t>(stamp_us >> 32));
    add_little(file, static_cast<std::uint32_t>(stamp_us));
    add_little(file, static_cast<std::uint32_t>(frame.size()));
    add_little(file, static_cast<std::uint32_t>(frame.size()));
    file.insert(file.end(), frame.begin(), frame.end());
    file.resize(file.size() + padded - frame.size(), 0);
    add_little(file, 32 + padded);
  }
  return file;
}

TEST_F(Sources, EveryLinkLayerGivesThePayload) {
  const Bytes ip = ipv4(packet_);
  const std::vector<std::pair<std::uint32_t, Bytes>> cases = {
      {1, ethernet(ip)},
      {1, ethernet(ip, {0x8100})},
      {1, ethernet(ip, {0x88A8, 0x8100})},
      {1, ethernet(ipv4(packet_, {.header_words = 8}))},
      {113, behind({0, 0, 0, 1, 0, 6, 1, 2, 3, 4, 5, 6, 0, 0, 0x08, 0x00}, ip)},
      {276, behind({0x08, 0x00, 0, 0, 0, 0, 0, 2, 0, 1, 0, 6, 1, 2, 3, 4, 5, 6, 0, 0}, ip)},
      {101, ip},
      {228, ip},
      {0, behind({2, 0, 0, 0}, ip)},
      {0, behind({0, 0, 0, 2}, ip)},
      {108, behind({0, 0, 0, 2}, ip)},
  };
  for (const auto& [link_type, frame] : cases) {
    SCOPED_TRACE(link_type);
    const auto source = open_pcap(write("a.pcap", pcap_file(kMicroseconds, link_type, {frame})));
    Datagram datagram;
    ASSERT_EQ(source->next(datagram, 0), Read::kDatagram);
    EXPECT_EQ(Bytes(datagram.payload.begin(), datagram.payload.end()), packet_);
    EXPECT_EQ(datagram.port, 2368);
    EXPECT_EQ(ipv4_text(datagram.sender), "192.168.1.201");
    EXPECT_EQ(datagram.received_ns, 1'700'000'000'000'007'000);
    EXPECT_EQ(source->next(datagram, 0), Read::kEnd);
    EXPECT_EQ(source->complaint(), "");
  }
}

TEST_F(Sources, NanosecondCapturesAndPcapng) {
  Datagram datagram;
  const auto fine =
      open_pcap(write("n.pcap", pcap_file(kNanoseconds, 1, {ethernet(ipv4(packet_))})));
  ASSERT_EQ(fine->next(datagram, 0), Read::kDatagram);
  EXPECT_EQ(datagram.received_ns, 1'700'000'000'000'000'007);

  const auto ng = open_pcap(write("n.pcapng", pcapng_file({ethernet(ipv4(packet_))})));
  ASSERT_EQ(ng->next(datagram, 0), Read::kDatagram);
  EXPECT_EQ(datagram.received_ns, 1'700'000'000'000'007'000);
  EXPECT_EQ(datagram.payload.size(), packet_.size());
}

TEST_F(Sources, FragmentsAndOtherTrafficArePassedOverAndCounted) {
  Bytes cut = ethernet(ipv4(packet_));
  cut.resize(600);
  Bytes ipv6 = ethernet(ipv4(packet_));
  ipv6[12] = 0x86;
  ipv6[13] = 0xDD;
  const auto source =
      open_pcap(write("a.pcap", pcap_file(kMicroseconds, 1,
                                          {ethernet(ipv4(packet_, {.fragment = 0x2000})),
                                           ethernet(ipv4(packet_, {.fragment = 0x00B9})),
                                           ethernet(ipv4(packet_, {.protocol = 6})),
                                           ipv6,
                                           cut,
                                           {1, 2, 3},
                                           ethernet(ipv4(packet_))})));
  Datagram datagram;
  ASSERT_EQ(source->next(datagram, 0), Read::kDatagram);
  EXPECT_EQ(source->next(datagram, 0), Read::kEnd);
  EXPECT_EQ(count_of(*source, "frames_fragment"), 2U);
  EXPECT_EQ(count_of(*source, "frames_not_udp"), 3U);
  EXPECT_EQ(count_of(*source, "frames_cut"), 1U);
}

TEST_F(Sources, ATruncatedCaptureKeepsWhatCameBeforeAndComplains) {
  const Bytes frame = ethernet(ipv4(packet_));
  Bytes file = pcap_file(kMicroseconds, 1, {frame, frame, frame});
  file.resize(file.size() - 500);
  const auto source = open_pcap(write("cut.pcap", file));
  Datagram datagram;
  EXPECT_EQ(source->next(datagram, 0), Read::kDatagram);
  EXPECT_EQ(source->next(datagram, 0), Read::kDatagram);
  EXPECT_EQ(source->next(datagram, 0), Read::kEnd);
  EXPECT_THAT(source->complaint(), HasSubstr("cut.pcap"));
  EXPECT_THAT(source->complaint(), HasSubstr("after 2 frames"));
  EXPECT_EQ(source->next(datagram, 0), Read::kEnd);
}

TEST_F(Sources, ErrorsNameTheFile) {
  const std::string missing = (folder_ / "missing.pcap").string();
  for (const auto& open :
       {std::function<void(const std::string&)>([](const std::string& p) { open_pcap(p); }),
        std::function<void(const std::string&)>(
            [](const std::string& p) { open_payload_file(p); })}) {
    EXPECT_THAT(error_of([&] { open(missing); }), HasSubstr(missing));
    EXPECT_THAT(error_of([&] { open(folder_.string()); }), HasSubstr("directory"));
  }
  EXPECT_THAT(error_of([&] { open_pcap(write("e.pcap", {})); }), HasSubstr("empty"));
  EXPECT_THAT(error_of([&] { open_payload_file(write("e.bin", {})); }), HasSubstr("0 bytes"));
  EXPECT_THAT(error_of([&] { open_pcap(write("t.txt", Bytes(100, 'a'))); }),
              HasSubstr("not a pcap"));
  EXPECT_THAT(error_of([&] { open_pcap(write("w.pcap", pcap_file(kMicroseconds, 147, {}))); }),
              HasSubstr("147"));
}

TEST_F(Sources, PayloadFilesReadEndToEndAndNameALeftOver) {
  Bytes bytes;
  for (int i = 0; i < 600; ++i) bytes.insert(bytes.end(), packet_.begin(), packet_.end());
  bytes.insert(bytes.end(), 100, 0);
  const auto source = open_payload_file(write("p.bin", bytes));
  Datagram datagram;
  int packets = 0;
  while (source->next(datagram, 0) == Read::kDatagram) {
    ASSERT_TRUE(std::equal(packet_.begin(), packet_.end(), datagram.payload.begin()));
    ++packets;
  }
  EXPECT_EQ(packets, 600);
  EXPECT_EQ(datagram.received_ns, 0);
  EXPECT_THAT(source->complaint(), HasSubstr("100 bytes"));
}

}  // namespace
}  // namespace zloam::driver
