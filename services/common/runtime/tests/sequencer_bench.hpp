#pragma once
// Shared by the sequencer's tests: messages with a number, and a sequencer with a clock.

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "common/messages/build.hpp"
#include "common/runtime/sequencer.hpp"

namespace zloam::runtime::test {

inline constexpr std::int64_t kMs = 1'000'000;

struct Spec {
  std::uint64_t run = 1;
  std::uint64_t sweep = 0;
  std::uint64_t seq = 0;
  bool replay = false;
  std::string instance = "a";
  std::int64_t period_ns = 100 * kMs;
};

inline Message message(const Spec& s) {
  HeaderFields h;
  h.robot = "r";
  h.frame = "lidar";
  h.run = s.run;
  h.sweep = s.sweep;
  h.seq = s.seq;
  h.replay = s.replay;
  h.instance = s.instance;
  h.stamp_ns = static_cast<std::int64_t>(s.sweep) * s.period_ns;
  auto buffer = std::make_shared<Buffer>(build(h, SweepFields{}));
  Message m;
  m.bytes = {buffer->data(), buffer->size()};
  m.header = message_of<msg::Sweep>(m.bytes).header();
  m.owner = buffer;
  return m;
}

struct Bench {
  explicit Bench(SequencerLimits limits = {}, bool is_replay = false)
      : sequencer(limits), replay(is_replay) {}
  std::optional<Drop> add(std::uint64_t sweep, std::uint64_t run = 1) {
    return sequencer.add(message({.run = run, .sweep = sweep, .seq = sweep, .replay = replay}),
                         now);
  }
  /// All sweeps that are handed out now.
  std::vector<std::uint64_t> out() {
    std::vector<std::uint64_t> sweeps;
    while (const auto m = sequencer.next(now)) sweeps.push_back(m->header->sweep());
    return sweeps;
  }
  Sequencer sequencer;
  bool replay;
  std::int64_t now = 1'000'000'000;
};

using Sweeps = std::vector<std::uint64_t>;

}  // namespace zloam::runtime::test
