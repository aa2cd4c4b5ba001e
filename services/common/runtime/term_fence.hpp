#pragma once
// Rejects messages of an instance that was overtaken and does not know it yet (docs/protocol.md,
// section 6): of the terms of one key's messages in one run the greatest counts as long as it is
// received. A silent term is forgotten, so that a forged one can't close a key for good. A driver
// that is restarted alone begins a run, and with it at term 1. Worker only.

#include <cstdint>

namespace zloam::runtime {

class TermFence {
 public:
  bool refuses(std::uint64_t run, std::uint32_t term, std::int64_t now_ns) const {
    constexpr std::int64_t kSilence_ns = 2'000'000'000;
    return run == run_ && term < greatest_ && now_ns - heard_ns_ < kSilence_ns;
  }
  /// Records a message that was not refused.
  void took(std::uint64_t run, std::uint32_t term, std::int64_t now_ns) {
    run_ = run;
    greatest_ = term;
    heard_ns_ = now_ns;
  }

 private:
  std::uint64_t run_ = 0;
  std::uint32_t greatest_ = 0;
  std::int64_t heard_ns_ = 0;
};

}  // namespace zloam::runtime
