#pragma once
// Detects a stage that keeps dying on its newest revision: lives that are short and in a row, each
// begun after the one before had ended. Without clock or transport; times are of any monotonic
// clock, ns.
//
// A link that breaks looks like the end of everyone behind it: those end together, and so count as
// one life.

#include <cstdint>
#include <limits>
#include <map>
#include <string>

namespace zloam::runtime {

class ShortLives {
 public:
  static constexpr std::int64_t kShort_ns = 10'000'000'000;
  static constexpr int kMost = 3;

  /// An instance's token, by its key, appeared.
  void came(const std::string& key, std::int64_t now_ns) {
    if (since_.size() < kMostTokens) since_.emplace(key, now_ns);
  }
  /// The token disappeared while `rev` was its stage's newest revision. True: it was the third
  /// short life in a row with that revision, which must be withdrawn.
  bool went(const std::string& key, const std::string& stage, std::uint32_t rev,
            std::int64_t now_ns) {
    const auto came = since_.find(key);
    if (came == since_.end()) return false;
    const std::int64_t came_ns = came->second;
    since_.erase(came);
    Row& row = rows_[stage];
    const bool is_short = now_ns - came_ns < kShort_ns;
    if (!is_short || row.rev != rev) row = {.rev = rev};
    if (!is_short || rev == 0 || came_ns < row.ended_ns) return false;
    row.ended_ns = now_ns;
    if (++row.count < kMost) return false;
    row.count = 0;
    return true;
  }

 private:
  static constexpr std::size_t kMostTokens = 256;
  struct Row {
    std::uint32_t rev = 0;
    int count = 0;
    /// end of the life counted last
    std::int64_t ended_ns = std::numeric_limits<std::int64_t>::min();
  };
  std::map<std::string, std::int64_t> since_;
  std::map<std::string, Row> rows_;
};

}  // namespace zloam::runtime
