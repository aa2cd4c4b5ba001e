#pragma once
// What an instance says that was overtaken and does not know it yet is not taken (docs/protocol.md,
// section 6): of the terms of one key's messages the greatest counts, as long as it is heard. A term
// that falls silent is forgotten, so that no forged one shuts a key for good. The worker's own.

#include <cstdint>

namespace zloam::runtime {

class TermFence {
 public:
  bool refuses(std::uint32_t term, std::int64_t now_ns) const {
    constexpr std::int64_t kSilence_ns = 2'000'000'000;
    return term < greatest_ && now_ns - heard_ns_ < kSilence_ns;
  }
  /// One that was not refused.
  void took(std::uint32_t term, std::int64_t now_ns) {
    greatest_ = term;
    heard_ns_ = now_ns;
  }

 private:
  std::uint32_t greatest_ = 0;
  std::int64_t heard_ns_ = 0;
};

}  // namespace zloam::runtime
