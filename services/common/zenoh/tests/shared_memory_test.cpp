// Messages between processes of one machine arrive through shared memory in one piece; memory that
// its publisher has overwritten is not used.
#include <gtest/gtest.h>
#include <sys/mman.h>
#include <sys/wait.h>

#include <algorithm>
#include <array>
#include <csignal>

#include "common/zenoh/aligned.hpp"
#include "common/zenoh/tests/support.hpp"

namespace zloam::zenoh::test {
namespace {

/// The program of shared_memory_peer.cpp; ends when its standard input is closed.
class Peer {
 public:
  Peer(int port, std::size_t size) {
    std::array<int, 2> input{};
    if (pipe(input.data()) != 0) throw std::runtime_error("pipe");
    const std::string to = endpoint(port);
    const std::string size_text = std::to_string(size);
    pid_ = fork();
    if (pid_ == 0) {
      dup2(input[0], STDIN_FILENO);
      close(input[0]);
      close(input[1]);
      execl(ZLOAM_SHARED_MEMORY_PEER, "shared_memory_peer", to.c_str(), size_text.c_str(), nullptr);
      _exit(127);
    }
    close(input[0]);
    input_ = input[1];
  }
  Peer(const Peer&) = delete;
  Peer& operator=(const Peer&) = delete;
  ~Peer() { join(); }
  int join() {
    if (pid_ <= 0) return -1;
    close(input_);
    int status = -1;
    waitpid(pid_, &status, 0);
    pid_ = -1;
    return status;
  }

 private:
  int input_ = -1;
  pid_t pid_ = -1;
};

Config shared_memory_config(Config config) {
  config.insert_json5("transport/shared_memory/enabled", "true");
  // Pools are locked in memory, own ones and those of others: together they must stay below the
  // 8 MiB that a user without privileges may lock.
  config.insert_json5("transport/shared_memory/transport_optimization/pool_size", "1048576");
  return config;
}

/// The first sample that came by shared memory; the pool may not be ready for the first ones.
std::optional<Sample> first_by_shared_memory(Mailbox& channel, TransferCounters& counters) {
  const auto end = std::chrono::steady_clock::now() + kPatience;
  while (std::chrono::steady_clock::now() < end) {
    auto sample = channel.recv(kPatience);
    if (!sample) return std::nullopt;
    view_aligned(sample->payload, &counters);
    if (sample->payload.is_shared_memory()) return sample;
  }
  return std::nullopt;
}

void expect_whole(const Sample& sample, std::size_t size) {
  EXPECT_EQ(sample.payload.size(), size);
  TransferCounters counters;
  const AlignedBytes view = view_aligned(sample.payload, &counters);
  EXPECT_FALSE(view.torn());
  EXPECT_FALSE(view.in_place());
  ASSERT_EQ(view.size(), size);
  EXPECT_EQ(counters.messages_shared_memory, 1u);
  EXPECT_EQ(counters.bytes_copied, size);
  const auto all_equal = [&](std::uint8_t byte) { return byte == view.data()[0]; };
  EXPECT_TRUE(std::all_of(view.data().begin(), view.data().end(), all_equal));
}

/// A message that the other process has published, which goes on publishing.
struct FromPeer {
  static constexpr std::size_t kSize = 300'000;
  int port = free_port();
  Session session = Session::open(shared_memory_config(listening_config(port)));
  Mailbox channel{session, "test/shm", 4};
  Peer peer{port, kSize};
  TransferCounters counters;
  std::optional<Sample> sample = first_by_shared_memory(channel, counters);
};

TEST(SharedMemory, BetweenTwoProcesses) {
  FromPeer from;
  ASSERT_TRUE(from.sample.has_value())
      << from.counters.messages_other << " messages went another way";
  expect_whole(*from.sample, FromPeer::kSize);
  EXPECT_EQ(from.counters.messages_shared_memory, 1u);
  EXPECT_EQ(from.peer.join(), 0);
}

/// Stops this process for a while, like a machine that swaps or a suspended container.
void stand_still(std::chrono::milliseconds time) {
  const pid_t self = getpid();
  const pid_t other = fork();
  if (other == 0) {
    kill(self, SIGSTOP);
    usleep(static_cast<useconds_t>(1000 * time.count()));
    kill(self, SIGCONT);
    _exit(0);
  }
  waitpid(other, nullptr, 0);
}

TEST(SharedMemory, WhatWasWrittenAgainWhileAReaderStoodStillIsTorn) {
  FromPeer from;
  ASSERT_TRUE(from.sample.has_value());
  const AlignedBytes before = view_aligned(from.sample->payload);
  ASSERT_FALSE(before.torn());
  // The publisher goes on, with a pool for some 13 messages.
  stand_still(std::chrono::milliseconds(800));
  const AlignedBytes after = view_aligned(from.sample->payload);
  EXPECT_TRUE(after.torn());
  EXPECT_EQ(after.size(), 0u);
  // The copy made in time is unchanged.
  const auto same = [&](std::uint8_t byte) { return byte == before.data()[0]; };
  EXPECT_TRUE(std::all_of(before.data().begin(), before.data().end(), same));
  EXPECT_EQ(from.peer.join(), 0);
}

constexpr std::chrono::milliseconds kBetween{500};

/// Puts 50 KB until a message comes by shared memory, or patience ends.
std::optional<Sample> exchange(Publisher& publisher, Mailbox& channel) {
  const auto end = std::chrono::steady_clock::now() + kPatience;
  std::optional<Sample> sample;
  while (std::chrono::steady_clock::now() < end) {
    publisher.put(Bytes::own(std::vector<std::uint8_t>(50'000, 9)));
    // A message may be lost while the link is new.
    sample = channel.recv(kBetween);
    if (sample && sample->payload.is_shared_memory()) break;
  }
  return sample;
}

TEST(SharedMemory, BetweenTwoSessionsAndNotForSmallMessages) {
  const int port = free_port();
  Session a = Session::open(shared_memory_config(listening_config(port)));
  Session b = Session::open(shared_memory_config(connecting_config(port)));
  Mailbox channel(b, "test/shm", 4);
  Publisher publisher = a.declare_publisher("test/shm");
  wait_matching(publisher);
  auto sample = exchange(publisher, channel);
  ASSERT_TRUE(sample && sample->payload.is_shared_memory());
  expect_whole(*sample, 50'000);
  publisher.put(Bytes::own(std::vector<std::uint8_t>(1000, 9)));
  sample = channel.recv(kPatience);
  ASSERT_TRUE(sample.has_value());
  EXPECT_FALSE(sample->payload.is_shared_memory());
  EXPECT_EQ(sample->payload.size(), 1000u);
  // A large message in parts does not use shared memory, and arrives with the same bytes.
  std::vector<std::uint8_t> bytes(50'000);
  for (std::size_t i = 0; i < bytes.size(); ++i) bytes[i] = static_cast<std::uint8_t>(i * 7 / 3);
  publisher.put(Bytes::copy_of(bytes).in_parts(3071));
  sample = channel.recv(kPatience);
  ASSERT_TRUE(sample.has_value());
  EXPECT_FALSE(sample->payload.is_shared_memory());
  std::vector<std::uint8_t> received(sample->payload.size());
  sample->payload.copy_to(received.data());
  EXPECT_EQ(received, bytes);
}

/// Zenoh locks its pools into memory; where it may not, it works without shared memory.
bool may_lock(std::size_t size) {
  void* memory = mmap(nullptr, size, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
  if (memory == MAP_FAILED) return false;
  const bool locked = mlock(memory, size) == 0;
  munmap(memory, size);
  return locked;
}

TEST(SharedMemory, IsOnByDefault) {
  constexpr std::size_t kTwoDefaultPools = 2 * 64 * 1024 * 1024;
  if (!may_lock(kTwoDefaultPools)) GTEST_SKIP() << "this user may not lock 128 MiB (ulimit -l)";
  const int port = free_port();
  Config listening = Config::create_default();
  listening.insert_json5("scouting/multicast/enabled", "false");
  listening.insert_json5("listen/endpoints", "[\"" + endpoint(port) + "\"]");
  Config connecting = Config::create_default();
  connecting.insert_json5("scouting/multicast/enabled", "false");
  connecting.insert_json5("listen/endpoints", "[]");
  connecting.insert_json5("connect/endpoints", "[\"" + endpoint(port) + "\"]");
  Session a = Session::open(listening);
  Session b = Session::open(connecting);
  Mailbox channel(b, "test/shm", 4);
  Publisher publisher = a.declare_publisher("test/shm");
  wait_matching(publisher);
  const auto sample = exchange(publisher, channel);
  ASSERT_TRUE(sample && sample->payload.is_shared_memory());
}

}  // namespace
}  // namespace zloam::zenoh::test
