#pragma once
// Payloads in a form that FlatBuffers can read: in place if contiguous at an address divisible by
// 8, else copied once to memory aligned to 64 bytes (as for messages over TCP). Shared memory is
// copied too: its publisher may write to it again while it is read (Bytes::is_intact), and verified
// bytes must not change afterwards.

#include <atomic>
#include <cstdint>
#include <memory>
#include <span>

#include "common/zenoh/zenoh.hpp"

namespace zloam::zenoh {

/// How messages arrived; shared by all threads of a process. For status.
struct TransferCounters {
  std::atomic<std::uint64_t> messages_shared_memory{0};
  std::atomic<std::uint64_t> messages_other{0};
  std::atomic<std::uint64_t> bytes_in_place{0};
  std::atomic<std::uint64_t> bytes_copied{0};
};

/// Contiguous bytes at an address divisible by 8, and their owner. A copy of this object shares
/// them. Spans from data() live as long as one of the copies.
class AlignedBytes {
 public:
  AlignedBytes() = default;
  std::span<const std::uint8_t> data() const { return data_; }
  std::size_t size() const { return data_.size(); }
  /// Whether these are the payload's own bytes.
  bool in_place() const { return copy_ == nullptr; }
  /// The shared memory was written again before it was read: there are no bytes.
  bool torn() const { return torn_; }
  /// For keeping it long: the existing copy, shared, or a new one. A payload in place may hold a
  /// receive buffer many times its size.
  Bytes to_keep() const;

 private:
  friend AlignedBytes view_aligned(Bytes payload, TransferCounters* counters);
  std::span<const std::uint8_t> data_;
  Bytes payload_;  // while in place
  std::shared_ptr<const std::uint8_t> copy_;
  bool torn_ = false;
};

inline constexpr std::size_t kInPlaceAlignment = 8;
inline constexpr std::size_t kCopyAlignment = 64;

/// Throws std::bad_alloc only.
AlignedBytes view_aligned(Bytes payload, TransferCounters* counters = nullptr);

}  // namespace zloam::zenoh
