#pragma once
// Shared by the tests of this folder and of the runtime: sessions on the loopback, and waiting for
// a condition.

#include <arpa/inet.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <atomic>
#include <chrono>
#include <concepts>
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <memory>
#include <mutex>
#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>

#include "common/zenoh/zenoh.hpp"

namespace zloam::zenoh::test {

/// Maximum wait for a condition: enough for a busy machine. Tests that succeed wait less.
inline constexpr std::chrono::seconds kPatience{90};

/// An address of the loopback, 127.x.y.z, that is this process's alone: tests that run beside each
/// other can't take each other's ports between the choice and the listening.
inline std::uint32_t own_address() {
  constexpr std::uint32_t kLoopback = 127U << 24, kHosts = (1U << 24) - 2;
  return kLoopback + 1 + static_cast<std::uint32_t>(getpid()) % kHosts;
}

/// A TCP port that is free now, at every address, and not among those that the system gives to
/// outgoing connections (32768 and above, as a rule).
inline int free_port() {
  constexpr int kFirst = 10'000, kCount = 20'000, kTries = 1000;
  static std::atomic<int> next{static_cast<int>(getpid()) * 37};
  for (int i = 0; i < kTries; ++i) {
    const int port = kFirst + next++ % kCount;
    const int fd = socket(AF_INET, SOCK_STREAM, 0);
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_addr.s_addr = htonl(INADDR_ANY);
    address.sin_port = htons(static_cast<std::uint16_t>(port));
    const bool is_free = bind(fd, reinterpret_cast<sockaddr*>(&address), sizeof(address)) == 0;
    close(fd);
    if (is_free) return port;
  }
  throw std::runtime_error("no free port");
}

inline std::string endpoint(int port) {
  const in_addr address{htonl(own_address())};
  return std::string("tcp/") + inet_ntoa(address) + ":" + std::to_string(port);
}

/// A peer that scouts nothing and uses no shared memory.
inline Config quiet_config() {
  Config config = Config::create_default();
  config.insert_json5("mode", "\"peer\"");
  config.insert_json5("scouting/multicast/enabled", "false");
  config.insert_json5("listen/endpoints", "[]");
  config.insert_json5("transport/shared_memory/enabled", "false");
  return config;
}

inline Config listening_config(int port) {
  Config config = quiet_config();
  config.insert_json5("listen/endpoints", "[\"" + endpoint(port) + "\"]");
  return config;
}

inline Config connecting_config(const std::string& to) {
  Config config = quiet_config();
  config.insert_json5("connect/endpoints", "[\"" + to + "\"]");
  return config;
}

inline Config connecting_config(int port) { return connecting_config(endpoint(port)); }

/// A session that talks to itself only.
inline Session lone_session() { return Session::open(quiet_config()); }

/// Two peers with a TCP link.
struct Pair {
  explicit Pair(int port = free_port())
      : a(Session::open(listening_config(port))), b(Session::open(connecting_config(port))) {}
  Session a;
  Session b;
};

/// A value that callbacks change and the test waits for.
template <class T>
class Watched {
 public:
  template <class F>
  void change(F&& f) {
    {
      const std::lock_guard lock(mutex_);
      f(value_);
    }
    changed_.notify_all();
  }
  /// False when the predicate did not become true in time.
  template <class Predicate>
  bool wait(Predicate&& predicate) {
    std::unique_lock lock(mutex_);
    return changed_.wait_for(lock, kPatience, [&] { return predicate(value_); });
  }
  T get() requires std::copyable<T> {
    const std::lock_guard lock(mutex_);
    return value_;
  }

 private:
  std::mutex mutex_;
  std::condition_variable changed_;
  T value_{};
};

/// A subscriber whose samples wait to be taken: the newest `room` of them.
class Mailbox {
 public:
  Mailbox(Session& session, std::string_view key, std::size_t room = 1000)
      : inside_(std::make_shared<Inside>()),
        subscriber_(session.declare_subscriber(key, [inside = inside_, room](Sample&& sample) {
          inside->push(std::move(sample), room);
        })) {}

  /// Nothing when none came in time.
  std::optional<Sample> recv(std::chrono::milliseconds timeout) { return inside_->pop(timeout); }

 private:
  struct Inside {
    void push(Sample&& sample, std::size_t room) {
      std::optional<Sample> oldest;  // freed outside the lock
      {
        const std::lock_guard lock(mutex);
        if (samples.size() == room) {
          oldest = std::move(samples.front());
          samples.pop_front();
        }
        samples.push_back(std::move(sample));
      }
      filled.notify_one();
    }
    std::optional<Sample> pop(std::chrono::milliseconds timeout) {
      std::unique_lock lock(mutex);
      const auto deadline = std::chrono::steady_clock::now() + timeout;
      if (!filled.wait_until(lock, deadline, [&] { return !samples.empty(); })) return std::nullopt;
      std::optional<Sample> sample(std::move(samples.front()));
      samples.pop_front();
      return sample;
    }

    std::mutex mutex;
    std::condition_variable filled;
    std::deque<Sample> samples;
  };

  std::shared_ptr<Inside> inside_;
  Subscriber subscriber_;
};

/// Waits until a subscriber of another session is known: messages put before that are lost.
inline void wait_matching(Publisher& publisher) {
  auto matching = std::make_shared<Watched<bool>>();
  publisher.on_matching([matching](bool now) { matching->change([&](bool& v) { v = now; }); });
  if (!matching->wait([](bool now) { return now; })) throw std::runtime_error("nobody matched");
}

}  // namespace zloam::zenoh::test
