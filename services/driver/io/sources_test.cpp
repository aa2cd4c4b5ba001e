// Files and sockets. Captures are written here byte by byte.
#include <arpa/inet.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>

#include "driver/io/link_layer.hpp"
#include "driver/io/packet_source.hpp"
#include "driver/io/scan_folder.hpp"
#include "driver/io/stream_filter.hpp"
#include "driver/velodyne/test_packets.hpp"

namespace zloam::driver {
namespace {

namespace fs = std::filesystem;
using Bytes = std::vector<std::uint8_t>;
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

class Sources : public ::testing::Test {
 protected:
  void SetUp() override {
    const auto* info = ::testing::UnitTest::GetInstance()->current_test_info();
    folder_ = fs::temp_directory_path() /
              ("zloam-sources-" + std::to_string(getpid()) + "-" + info->name());
    fs::create_directories(folder_);
    test::TurningSensor sensor;
    const test::Payload payload = sensor.next();
    packet_.assign(payload.begin(), payload.end());
  }
  void TearDown() override { fs::remove_all(folder_); }

  std::string write(const std::string& name, const Bytes& bytes) {
    const fs::path path = folder_ / name;
    fs::create_directories(path.parent_path());
    std::ofstream file(path, std::ios::binary);
    file.write(reinterpret_cast<const char*>(bytes.data()),
               static_cast<std::streamsize>(bytes.size()));
    return path.string();
  }

  static std::uint64_t count_of(const PacketSource& source, std::string_view name) {
    for (const auto& [key, value] : source.counts()) {
      if (key == name) return value;
    }
    ADD_FAILURE() << "no count " << name;
    return 0;
  }

  static std::string error_of(const std::function<void()>& action) {
    try {
      action();
    } catch (const SourceError& error) {
      return error.what();
    }
    return "no error";
  }

  fs::path folder_;
  Bytes packet_;
};

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

void send_to(std::uint16_t port, const Bytes& bytes, const char* to_address = "127.0.0.1",
             const char* from_address = "127.0.0.1") {
  const int fd = socket(AF_INET, SOCK_DGRAM, 0);
  const int on = 1;
  setsockopt(fd, SOL_SOCKET, SO_BROADCAST, &on, sizeof on);
  sockaddr_in from{};
  from.sin_family = AF_INET;
  from.sin_addr.s_addr = htonl(parse_ipv4(from_address));
  ASSERT_EQ(bind(fd, reinterpret_cast<sockaddr*>(&from), sizeof from), 0);
  setsockopt(fd, IPPROTO_IP, IP_MULTICAST_IF, &from.sin_addr, sizeof from.sin_addr);
  sockaddr_in to{};
  to.sin_family = AF_INET;
  to.sin_port = htons(port);
  to.sin_addr.s_addr = htonl(parse_ipv4(to_address));
  ASSERT_EQ(sendto(fd, bytes.data(), bytes.size(), 0, reinterpret_cast<sockaddr*>(&to), sizeof to),
            static_cast<ssize_t>(bytes.size()));
  close(fd);
}

TEST_F(Sources, BroadcastsAreHeard) {
  const auto source = open_udp({.data_port = 0, .position_port = 0});
  send_to(source->data_port(), packet_, "127.255.255.255");
  Datagram datagram;
  ASSERT_EQ(source->next(datagram, 10'000), Read::kDatagram);
  EXPECT_EQ(datagram.payload.size(), packet_.size());
}

TEST_F(Sources, AGroupIsJoinedOrRefused) {
  EXPECT_THAT(error_of([] {
                open_udp({.data_port = 0, .position_port = 0, .multicast_group = "10.0.0.1"});
              }),
              HasSubstr("10.0.0.1"));
}

// Two programs, one for each sensor, listen on one port. What is sent to this host alone reaches
// the program that named the sender; what is broadcast reaches both, and one keeps it.
TEST_F(Sources, TwoSensorsOnOnePortAreToldApartByAddress) {
  const auto first =
      open_udp({.data_port = 0, .position_port = 0, .sender = parse_ipv4("127.0.0.2")});
  const auto second = open_udp(
      {.data_port = first->data_port(), .position_port = 0, .sender = parse_ipv4("127.0.0.3")});
  for (const char* to : {"127.0.0.1", "127.255.255.255"}) {
    SCOPED_TRACE(to);
    for (int i = 0; i < 5; ++i) {
      send_to(first->data_port(), packet_, to, "127.0.0.2");
      send_to(first->data_port(), packet_, to, "127.0.0.3");
    }
    const auto heard = [](UdpSource& source, const std::string& address) {
      StreamFilter filter(0, parse_ipv4(address));
      Datagram datagram;
      int count = 0;
      while (source.next(datagram, 0) == Read::kDatagram) {
        count += filter.classify(datagram) == DatagramKind::kData;
      }
      return count;
    };
    EXPECT_EQ(heard(*first, "127.0.0.2"), 5);
    EXPECT_EQ(heard(*second, "127.0.0.3"), 5);
  }
}

TEST_F(Sources, UdpReceivesOnBothPortsWithKernelTime) {
  const auto source = open_udp({.bind_address = "127.0.0.1", .data_port = 0, .position_port = 0});
  send_to(source->data_port(), packet_);
  send_to(source->position_port(), Bytes(512, 1));
  std::vector<std::size_t> sizes;
  Datagram datagram;
  while (sizes.size() < 2) {
    ASSERT_EQ(source->next(datagram, 10'000), Read::kDatagram);
    sizes.push_back(datagram.payload.size());
    EXPECT_GT(datagram.received_ns, 1'600'000'000'000'000'000);
    EXPECT_EQ(ipv4_text(datagram.sender), "127.0.0.1");
  }
  EXPECT_THAT(sizes, ::testing::UnorderedElementsAre(1206, 512));
  EXPECT_EQ(source->next(datagram, 0), Read::kTimeout);
  EXPECT_EQ(count_of(*source, "kernel_drops"), 0U);
}

TEST_F(Sources, UdpCountsWhatTheKernelDropped) {
  const auto source = open_udp({.bind_address = "127.0.0.1",
                                .data_port = 0,
                                .position_port = 0,
                                .receive_buffer_bytes = 16'384});
  for (int i = 0; i < 200; ++i) send_to(source->data_port(), packet_);
  Datagram datagram;
  std::uint64_t got = 0;
  while (source->next(datagram, 0) == Read::kDatagram) ++got;
  ASSERT_LT(got, 200U);
  // The kernel tells its count with the next packet that fits.
  send_to(source->data_port(), packet_);
  ASSERT_EQ(source->next(datagram, 10'000), Read::kDatagram);
  EXPECT_EQ(count_of(*source, "kernel_drops"), 200U - got);
}

TEST_F(Sources, APortInUseIsSaidSo) {
  const auto first = open_udp({.bind_address = "127.0.0.1", .data_port = 0, .position_port = 0});
  const std::string error = error_of([&] {
    open_udp({.bind_address = "127.0.0.1", .data_port = first->data_port(), .position_port = 0});
  });
  EXPECT_THAT(error, HasSubstr(std::to_string(first->data_port())));
  EXPECT_THAT(error, HasSubstr("in use"));
  EXPECT_THAT(error_of([] { open_udp({.bind_address = "no address"}); }), HasSubstr("no address"));
}

TEST(StreamFilter, ByLengthAndOneSensorOnly) {
  const Bytes data(1206), position(512), other(100);
  const auto at = [](const Bytes& bytes, unsigned port, std::uint32_t sender) {
    return Datagram{bytes, 0, static_cast<std::uint16_t>(port), sender};
  };
  StreamFilter filter(0, 0);
  EXPECT_EQ(filter.classify(at(other, 53, 9)), DatagramKind::kForeign);
  EXPECT_EQ(filter.classify(at(data, 4000, 1)), DatagramKind::kData);
  EXPECT_EQ(filter.classify(at(data, 4000, 2)), DatagramKind::kForeign);
  EXPECT_EQ(filter.classify(at(data, 4001, 1)), DatagramKind::kForeign);
  EXPECT_EQ(filter.classify(at(position, 8308, 1)), DatagramKind::kPosition);
  EXPECT_EQ(filter.classify(at(other, 4000, 1)), DatagramKind::kMalformed);
  EXPECT_EQ(filter.foreign(), 3U);
  StreamFilter fixed(2368, 7);
  EXPECT_EQ(fixed.classify(at(data, 2369, 7)), DatagramKind::kForeign);
  EXPECT_EQ(fixed.classify(at(data, 2368, 8)), DatagramKind::kForeign);
  EXPECT_EQ(fixed.classify(at(data, 2368, 7)), DatagramKind::kData);
}

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
