#pragma once
// Detects a stage that keeps dying on its newest revision: consecutive instances that end soon
// after their start. Without clock or transport; times are of any monotonic clock, ns.

#include <cstdint>
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
    const bool is_short = now_ns - came->second < kShort_ns;
    since_.erase(came);
    Row& row = rows_[stage];
    if (!is_short || row.rev != rev) row = {rev, 0};
    if (!is_short || rev == 0) return false;
    return ++row.count == kMost;
  }

 private:
  static constexpr std::size_t kMostTokens = 256;
  struct Row {
    std::uint32_t rev = 0;
    int count = 0;
  };
  std::map<std::string, std::int64_t> since_;
  std::map<std::string, Row> rows_;
};

}  // namespace zloam::runtime
