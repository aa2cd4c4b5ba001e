// UDP sockets, and which of the datagrams received there belong to the sensor.
#include <arpa/inet.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <chrono>
#include <sstream>
#include <thread>

#include "driver/io/closed_ports.hpp"
#include "driver/io/link_layer.hpp"
#include "driver/io/stream_filter.hpp"
#include "driver/io/test_sources.hpp"

namespace zloam::driver {
namespace {

using test::Bytes;
using test::Sources;
using ::testing::HasSubstr;

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

// Two programs listen on one port, each for its own sensor. Unicasts reach the program that named
// the sender; broadcasts reach both, and the filter of one keeps them.
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
      Makers makers_of_filter({});
      StreamFilter filter(0, parse_ipv4(address), makers_of_filter);
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

// Both ports have waiting datagrams, as in a driver that lags.
TEST_F(Sources, UdpReceivesBothPortsInTheOrderOfTheirComing) {
  const auto source = open_udp({.bind_address = "127.0.0.1", .data_port = 0, .position_port = 0});
  // If no socket on the machine has requested receive stamps before, the kernel starts to stamp
  // packets shortly after the request (net_enable_timestamp); until then it stamps them when they
  // are read.
  std::this_thread::sleep_for(std::chrono::milliseconds(200));
  const std::vector<std::size_t> sent = {1206, 1206, 512, 1206, 512, 512, 1206, 1206};
  for (const std::size_t size : sent) {
    send_to(size == 512 ? source->position_port() : source->data_port(), Bytes(size, 1));
  }
  std::vector<std::size_t> sizes;
  Datagram datagram;
  while (source->next(datagram, 1000) == Read::kDatagram) sizes.push_back(datagram.payload.size());
  EXPECT_EQ(sizes, sent);
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
  // The kernel reports its count with the next packet that fits.
  send_to(source->data_port(), packet_);
  ASSERT_EQ(source->next(datagram, 10'000), Read::kDatagram);
  EXPECT_EQ(count_of(*source, "kernel_drops"), 200U - got);
}

TEST_F(Sources, WhatNoProgramListensForIsCounted) {
  std::uint16_t closed = 0;
  {
    const auto source = open_udp({.bind_address = "127.0.0.1", .data_port = 0, .position_port = 0});
    closed = source->data_port();
  }
  const std::uint64_t before = datagrams_to_closed_ports();
  for (int i = 0; i < 50; ++i) send_to(closed, packet_);
  for (int i = 0; i < 50; ++i) send_to(closed, packet_, "127.255.255.255");
  EXPECT_GE(datagrams_to_closed_ports(), before + 100);
}

TEST(ClosedPorts, TheFieldsAreFoundByTheirNames) {
  std::istringstream known(
      "Tcp: NoPorts\nTcp: 7\nUdp: InDatagrams NoPorts InErrors IgnoredMulti\n"
      "Udp: 1000 20 3 400\nUdpLite: NoPorts\nUdpLite: 5\n");
  EXPECT_EQ(datagrams_to_closed_ports(known), 420U);
  std::istringstream unknown("Udp: InDatagrams\n");
  EXPECT_EQ(datagrams_to_closed_ports(unknown), 0U);
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

}  // namespace
}  // namespace zloam::driver
