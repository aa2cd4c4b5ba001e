#pragma once
// Open-addressing hash from a packed grid index to a slot number. Accessed by key only, never
// iterated, so that a hash order can't affect a result.

#include <cstdint>
#include <optional>
#include <vector>

namespace zloam {

class FlatIndex {
 public:
  static constexpr std::uint32_t kNone = 0xffffffffU;

  explicit FlatIndex(std::size_t capacity = 64);
  /// Slot of the key, or kNone.
  std::uint32_t find(std::uint64_t key) const {
    for (std::size_t at = home(key);; at = (at + 1) & mask_) {
      if (keys_[at] == key) return values_[at];
      if (keys_[at] == kFree) return kNone;
    }
  }
  /// Prefetches for a coming find() of the key.
  void prefetch(std::uint64_t key) const {
    __builtin_prefetch(&keys_[home(key)]);
    __builtin_prefetch(&values_[home(key)]);
  }
  /// The key must not be present yet, and its highest bit must be clear.
  void insert(std::uint64_t key, std::uint32_t value);
  void erase(std::uint64_t key);
  std::size_t size() const { return size_; }

 private:
  static constexpr std::uint64_t kFree = ~std::uint64_t{0};

  std::size_t home(std::uint64_t key) const {
    return static_cast<std::size_t>((key * 0x9E3779B97F4A7C15ULL) >> shift_);
  }
  void grow();

  // Separate, because together they would be padded by a third.
  std::vector<std::uint64_t> keys_;
  std::vector<std::uint32_t> values_;
  std::size_t mask_ = 0;
  std::size_t size_ = 0;
  unsigned shift_ = 0;
};

}  // namespace zloam
