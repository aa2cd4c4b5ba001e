// Captures, written here byte by byte, and files of bare payloads.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>

#include "driver/io/link_layer.hpp"
#include "driver/io/metadata_file.hpp"
#include "driver/io/test_sources.hpp"
#include "driver/velodyne/test_calibration.hpp"

namespace zloam::driver {
namespace {

using test::Bytes;
using test::Sources;
using ::testing::HasSubstr;
using ::testing::Not;

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

/// Builds a pcapng file, block by block.
class Pcapng {
 public:
  Bytes file;

  void section(bool big_endian = false) {
    big_ = big_endian;
    block(0x0A0D0D0A, [&](Bytes& body) {
      word(body, 0x1A2B3C4D);
      half(body, 1), half(body, 0);
      word(body, 0xFFFFFFFF), word(body, 0xFFFFFFFF);
    });
  }
  /// resolution: value of if_tsresol; 0: the option is omitted.
  void interface(unsigned link_type, std::uint32_t snap_bytes = 65535, unsigned resolution = 0,
                 std::uint32_t offset_s = 0) {
    block(1, [&](Bytes& body) {
      half(body, link_type), half(body, 0);
      word(body, snap_bytes);
      if (resolution != 0) {
        half(body, 9), half(body, 1);
        body.push_back(static_cast<std::uint8_t>(resolution));
        body.resize(body.size() + 3);
      }
      if (offset_s != 0) {
        half(body, 14), half(body, 8);
        word(body, big_ ? 0 : offset_s), word(body, big_ ? offset_s : 0);
      }
      half(body, 0), half(body, 0);
    });
  }
  void packet(unsigned interface, std::uint64_t units, const Bytes& frame) {
    block(6, [&](Bytes& body) {
      word(body, interface);
      word(body, static_cast<std::uint32_t>(units >> 32));
      word(body, static_cast<std::uint32_t>(units));
      word(body, static_cast<std::uint32_t>(frame.size()));
      word(body, static_cast<std::uint32_t>(frame.size()));
      body.insert(body.end(), frame.begin(), frame.end());
    });
  }
  void other(std::uint32_t type, std::size_t bytes) {
    block(type, [&](Bytes& body) { body.resize(bytes, 0x55); });
  }
  void simple_packet(const Bytes& frame) {
    block(3, [&](Bytes& body) {
      word(body, static_cast<std::uint32_t>(frame.size()));
      body.insert(body.end(), frame.begin(), frame.end());
    });
  }

 private:
  void put(Bytes& bytes, std::uint32_t value, int count) const {
    for (int i = 0; i < count; ++i) {
      const int place = big_ ? count - 1 - i : i;
      bytes.push_back(static_cast<std::uint8_t>(value >> (8 * place)));
    }
  }
  void word(Bytes& bytes, std::uint32_t value) const { put(bytes, value, 4); }
  void half(Bytes& bytes, unsigned value) const { put(bytes, value, 2); }

  template <class Fill>
  void block(std::uint32_t type, Fill fill) {
    Bytes body;
    fill(body);
    body.resize((body.size() + 3) / 4 * 4);
    const auto length = static_cast<std::uint32_t>(body.size() + 12);
    word(file, type);
    word(file, length);
    file.insert(file.end(), body.begin(), body.end());
    word(file, length);
  }

  bool big_ = false;
};

/// Each frame in a block of its own, stamped in microseconds.
Bytes pcapng_file(const std::vector<Bytes>& frames) {
  Pcapng capture;
  capture.section();
  capture.interface(1);
  for (const Bytes& frame : frames) capture.packet(0, 1'700'000'000'000'007, frame);
  return capture.file;
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
                                           ethernet(ipv4(packet_, {.fragment = 0x20B9})),
                                           ethernet(ipv4(packet_, {.protocol = 6})),
                                           ipv6,
                                           cut,
                                           {1, 2, 3},
                                           ethernet(ipv4(packet_))})));
  Datagram datagram;
  ASSERT_EQ(source->next(datagram, 0), Read::kDatagram);
  EXPECT_EQ(source->next(datagram, 0), Read::kEnd);
  EXPECT_EQ(count_of(*source, "frames_fragment"), 2U);
  EXPECT_EQ(count_of(*source, "frames_not_udp"), 2U);
  EXPECT_EQ(count_of(*source, "frames_ipv6"), 1U);
  EXPECT_EQ(count_of(*source, "frames_cut"), 1U);
  EXPECT_THAT(source->complaint(), Not(HasSubstr("IPv6")));
}

TEST_F(Sources, ACaptureOfIpv6SaysSo) {
  Bytes ip = ipv4(packet_);
  ip[0] = 0x60;
  Bytes tagged = ethernet(ip, {0x8100});
  tagged[16] = 0x86;
  tagged[17] = 0xDD;
  const std::vector<std::pair<std::uint32_t, Bytes>> cases = {
      {1, tagged}, {101, ip}, {0, behind({30, 0, 0, 0}, ip)}, {108, behind({0, 0, 0, 24}, ip)}};
  for (const auto& [link_type, frame] : cases) {
    SCOPED_TRACE(link_type);
    const auto source = open_pcap(write("v6.pcap", pcap_file(kMicroseconds, link_type, {frame})));
    Datagram datagram;
    EXPECT_EQ(source->next(datagram, 0), Read::kEnd);
    EXPECT_EQ(count_of(*source, "frames_ipv6"), 1U);
    EXPECT_EQ(count_of(*source, "frames_not_udp"), 0U);
    EXPECT_THAT(source->complaint(), HasSubstr("1 IPv6 packets are not read"));
  }
}

// Other machines on the network send some datagrams by IPv4.
TEST_F(Sources, ACaptureOfIpv6SaysSoBesideOtherTraffic) {
  Bytes ip = ipv4(packet_);
  ip[0] = 0x60;
  for (const std::size_t count : {10U, 200U}) {
    std::vector<Bytes> frames(count, ip);
    frames.push_back(ipv4(packet_));
    const auto source = open_pcap(write("v6.pcap", pcap_file(kMicroseconds, 101, frames)));
    Datagram datagram;
    EXPECT_EQ(source->next(datagram, 0), Read::kDatagram);
    EXPECT_EQ(source->next(datagram, 0), Read::kEnd);
    EXPECT_EQ(source->complaint().empty(), count == 10) << source->complaint();
  }
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
            [](const std::string& p) { open_payload_file(p, 1206); })}) {
    EXPECT_THAT(error_of([&] { open(missing); }), HasSubstr(missing));
    EXPECT_THAT(error_of([&] { open(folder_.string()); }), HasSubstr("directory"));
  }
  EXPECT_THAT(error_of([&] { open_pcap(write("e.pcap", {})); }), HasSubstr("empty"));
  EXPECT_THAT(error_of([&] { open_payload_file(write("e.bin", {}), 1206); }), HasSubstr("0 bytes"));
  EXPECT_THAT(error_of([&] { open_payload_file(write("p.bin", packet_), 0); }),
              HasSubstr("driver.metadata"));
  EXPECT_THAT(error_of([&] { open_pcap(write("t.txt", Bytes(100, 'a'))); }),
              HasSubstr("not a pcap"));
  EXPECT_THAT(error_of([&] { open_pcap(write("w.pcap", pcap_file(kMicroseconds, 147, {}))); }),
              HasSubstr("147"));
}

TEST_F(Sources, MetadataOfAWindowsShellAreReadOrTheirCodingIsNamed) {
  const std::string yaml = "\xEF\xBB\xBF" + velodyne::test::calibration_yaml();
  const std::string xml = "\xEF\xBB\xBF" + velodyne::test::calibration_xml();
  for (const std::string& text : {yaml, xml}) {
    DecodingOptions options;
    read_metadata(write("unit", Bytes(text.begin(), text.end())), "", options);
    EXPECT_EQ(options.metadata, text.substr(3));
  }
  DecodingOptions options;
  const std::string path = write("os1.json", {0xFF, 0xFE, '{', 0});
  EXPECT_THAT(error_of([&] { read_metadata(path, "", options); }), HasSubstr("is UTF-16"));
}

TEST_F(Sources, PayloadFilesReadEndToEndAndNameALeftOver) {
  Bytes bytes;
  for (int i = 0; i < 600; ++i) bytes.insert(bytes.end(), packet_.begin(), packet_.end());
  bytes.insert(bytes.end(), 100, 0);
  const auto source = open_payload_file(write("p.bin", bytes), 1206);
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

TEST_F(Sources, EveryInterfaceOfAPcapngFileIsReadByItsOwnKind) {
  const Bytes frame = ethernet(ipv4(packet_));
  const Bytes cooked =
      behind({0, 0, 0, 1, 0, 6, 1, 2, 3, 4, 5, 6, 0, 0, 0x08, 0x00}, ipv4(packet_));
  Pcapng capture;
  capture.section();
  capture.interface(147, 65535);             // unsupported link type
  capture.interface(1, 262144, 9);           // ns
  capture.interface(113, 2048);              // us
  capture.interface(1, 0, 0x80 | 20, 1000);  // 2^-20 s, offset 1000 s
  capture.other(4, 40);                      // name resolution
  capture.packet(0, 1, frame);
  capture.packet(1, 1'700'000'000'000'000'009, frame);
  capture.packet(2, 1'700'000'000'000'007, cooked);
  capture.packet(3, std::uint64_t{3} << 19, frame);
  capture.other(5, 12);  // statistics
  capture.section(true);
  capture.interface(1, 65535, 3, 2000);  // ms; interfaces are counted from 0 again
  capture.packet(0, 1'500, frame);
  capture.simple_packet(frame);
  const auto source = open_pcap(write("many.pcapng", capture.file));
  Datagram datagram;
  for (const std::int64_t expected_ns : {1'700'000'000'000'000'009, 1'700'000'000'000'007'000,
                                         1'001'500'000'000, 2'001'500'000'000, std::int64_t{0}}) {
    ASSERT_EQ(source->next(datagram, 0), Read::kDatagram);
    EXPECT_EQ(datagram.received_ns, expected_ns);
    EXPECT_EQ(Bytes(datagram.payload.begin(), datagram.payload.end()), packet_);
  }
  EXPECT_EQ(source->next(datagram, 0), Read::kEnd);
  EXPECT_EQ(count_of(*source, "frames_other_link"), 1U);
  EXPECT_THAT(source->complaint(), HasSubstr("147"));
}

TEST_F(Sources, ADamagedPcapngFileKeepsWhatCameBeforeAndSaysWhy) {
  const Bytes whole = pcapng_file({ethernet(ipv4(packet_)), ethernet(ipv4(packet_))});
  for (std::size_t bytes = 4; bytes < whole.size(); ++bytes) {
    const auto source =
        open_pcap(write("cut.pcapng", Bytes(whole.begin(), whole.begin() + std::ptrdiff_t(bytes))));
    Datagram datagram;
    int kept = 0;
    while (source->next(datagram, 0) == Read::kDatagram) ++kept;
    // Section and interface take 52 bytes, and the packets' blocks are equally long.
    const std::size_t first_packet_end = (whole.size() + 52) / 2;
    ASSERT_EQ(kept, bytes < first_packet_end ? 0 : 1) << bytes;
    const bool between_blocks = bytes == 28 || bytes == 52 || bytes == first_packet_end;
    ASSERT_EQ(source->complaint().empty(), between_blocks) << bytes << source->complaint();
  }
}

/// Fragments of one datagram with 1234 bytes, as from a tunnel with a small MTU.
std::vector<Bytes> in_fragments(const Bytes& payload, unsigned number) {
  const Bytes whole = ipv4(payload);
  std::vector<Bytes> frames;
  for (std::size_t at = 20; at < whole.size(); at += 552) {
    const std::size_t end = std::min(at + 552, whole.size());
    Bytes ip(whole.begin(), whole.begin() + 20);
    const auto length = static_cast<unsigned>(20 + end - at);
    const unsigned field = (end < whole.size() ? 0x2000U : 0U) | static_cast<unsigned>(at - 20) / 8;
    ip[2] = static_cast<std::uint8_t>(length >> 8), ip[3] = static_cast<std::uint8_t>(length);
    ip[4] = static_cast<std::uint8_t>(number >> 8), ip[5] = static_cast<std::uint8_t>(number);
    ip[6] = static_cast<std::uint8_t>(field >> 8), ip[7] = static_cast<std::uint8_t>(field);
    ip.insert(ip.end(), whole.begin() + std::ptrdiff_t(at), whole.begin() + std::ptrdiff_t(end));
    frames.push_back(ethernet(ip));
    // With Ethernet's padding to 60 bytes and its check sequence.
    frames.back().resize(std::max<std::size_t>(frames.back().size(), 60) + 4);
  }
  return frames;
}

TEST_F(Sources, FragmentsAreOneDatagramInWhateverOrderTheyCome) {
  Bytes second = packet_;
  second[1200] ^= 1;
  const std::vector<Bytes> a = in_fragments(packet_, 7), b = in_fragments(second, 8);
  ASSERT_EQ(a.size(), 3U);
  const auto source = open_pcap(write(
      "f.pcap",
      pcap_file(kMicroseconds, 1, {a[0], a[1], a[2], b[2], a[0], b[0], b[0], b[1], a[2], a[1]})));
  Datagram datagram;
  for (const Bytes& expected : {packet_, second, packet_}) {
    ASSERT_EQ(source->next(datagram, 0), Read::kDatagram);
    EXPECT_EQ(Bytes(datagram.payload.begin(), datagram.payload.end()), expected);
    EXPECT_EQ(datagram.port, 2368);
    EXPECT_EQ(ipv4_text(datagram.sender), "192.168.1.201");
  }
  EXPECT_EQ(source->next(datagram, 0), Read::kEnd);
  EXPECT_EQ(source->complaint(), "");
}

// A sensor of 2560 datagrams a second uses each number again after 26 s.
TEST_F(Sources, FragmentsOfANumberThatIsUsedAgainAreNotMixed) {
  constexpr std::uint64_t kStartUs = 1'700'000'000'000'000, kAgainUs = kStartUs + 26'000'000;
  Bytes second = packet_;
  for (std::uint8_t& byte : second) byte ^= 1;
  const std::vector<Bytes> a = in_fragments(packet_, 7), b = in_fragments(second, 7);
  Pcapng capture;
  capture.section();
  capture.interface(1);
  // The first fragment of the first datagram is lost.
  for (const Bytes& frame : {a[1], a[2]}) capture.packet(0, kStartUs, frame);
  for (const Bytes& frame : b) capture.packet(0, kAgainUs, frame);
  const auto source = open_pcap(write("again.pcapng", capture.file));
  Datagram datagram;
  ASSERT_EQ(source->next(datagram, 0), Read::kDatagram);
  EXPECT_EQ(Bytes(datagram.payload.begin(), datagram.payload.end()), second);
  EXPECT_EQ(source->next(datagram, 0), Read::kEnd);
  EXPECT_EQ(count_of(*source, "datagrams_not_whole"), 1U);
}

// As `tcpdump -i any` records them on a bridge and on the card in it.
TEST_F(Sources, FragmentsThatComeTwiceLackNothing) {
  std::vector<Bytes> frames;
  for (unsigned number = 0; number < 100; ++number) {
    for (const Bytes& frame : in_fragments(packet_, number)) {
      frames.insert(frames.end(), {frame, frame});
    }
  }
  const auto source = open_pcap(write("f.pcap", pcap_file(kMicroseconds, 1, frames)));
  Datagram datagram;
  int datagrams = 0;
  while (source->next(datagram, 0) == Read::kDatagram) ++datagrams;
  EXPECT_EQ(datagrams, 100);
  EXPECT_EQ(count_of(*source, "datagrams_not_whole"), 0U);
  EXPECT_EQ(source->complaint(), "");
}

TEST_F(Sources, FragmentsWithoutTheirRestAreBoundedAndSaid) {
  std::vector<Bytes> frames;
  for (unsigned number = 0; number < 1000; ++number) {
    frames.push_back(in_fragments(packet_, number).front());
  }
  for (const Bytes& frame : in_fragments(packet_, 2000)) frames.push_back(frame);
  const auto source = open_pcap(write("f.pcap", pcap_file(kMicroseconds, 1, frames)));
  Datagram datagram;
  ASSERT_EQ(source->next(datagram, 0), Read::kDatagram);
  EXPECT_EQ(source->next(datagram, 0), Read::kEnd);
  EXPECT_EQ(count_of(*source, "datagrams_not_whole"), 1000U);
  EXPECT_THAT(source->complaint(), HasSubstr("1000 datagrams lack"));
}

TEST_F(Sources, ACaptureOfHeadsOnlySaysSo) {
  Bytes head = ethernet(ipv4(packet_));
  head.resize(512);
  const auto source = open_pcap(write("s.pcap", pcap_file(kMicroseconds, 1, {head, head})));
  Datagram datagram;
  EXPECT_EQ(source->next(datagram, 0), Read::kEnd);
  EXPECT_THAT(source->complaint(), HasSubstr("snap length"));
}

}  // namespace
}  // namespace zloam::driver
