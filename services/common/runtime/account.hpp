#pragma once
// The account of each received message (docs/protocol.md, section 2). All counters of one process
// change under one mutex, so that a snapshot always satisfies
//   received = processed + not_mine + queued + in_work + sum of dropped

#include <array>
#include <cstdint>
#include <string>

namespace zloam::runtime {

enum class Drop : std::uint8_t {
  kDuplicate,
  kFenced,
  kLate,
  kQueueFull,
  kGarbage,
  kWrongRun,
  /// Refused before it counted for its sweep; the sweep stays missing.
  kInvalid,
  /// Accepted, but processing failed.
  kFailed,
  /// Its shared memory was written again before it was read; the sweep stays missing.
  kTorn,
};
inline constexpr std::size_t kDropReasons = 9;
const char* drop_name(Drop reason);

struct Account {
  std::string key;
  std::uint64_t received = 0;
  std::uint64_t processed = 0;
  std::uint64_t not_mine = 0;
  std::uint64_t queued = 0;
  std::uint64_t in_work = 0;
  std::array<std::uint64_t, kDropReasons> dropped{};
  /// never received and given up; not counted as drops
  std::uint64_t lost = 0;
  /// received messages that were requested by number
  std::uint64_t recovered = 0;

  std::uint64_t dropped_total() const;
  bool balanced() const {
    return received == processed + not_mine + queued + in_work + dropped_total();
  }
};

}  // namespace zloam::runtime
