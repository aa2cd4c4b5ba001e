#pragma once
// Index-addressed storage that grows without moving or copying its content, and reuses released
// values, last in first out.

#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

namespace zloam {

template <typename T>
class Pool {
 public:
  T& operator[](std::uint32_t i) { return chunks_[i >> kBits][i & kMask]; }
  const T& operator[](std::uint32_t i) const { return chunks_[i >> kBits][i & kMask]; }

  /// Index of a fresh default value.
  std::uint32_t take() {
    if (!free_.empty()) {
      const std::uint32_t i = free_.back();
      free_.pop_back();
      (*this)[i] = T();
      return i;
    }
    if ((size_ & kMask) == 0) {
      chunks_.push_back(std::make_unique<T[]>(kMask + 1));
    }
    return size_++;
  }

  /// Prefetches a value that is needed soon.
  void fetch(std::uint32_t i) const {
    constexpr std::size_t kLine = 64;
    const char* at = reinterpret_cast<const char*>(&(*this)[i]);
    for (std::size_t b = 0; b < sizeof(T); b += kLine) __builtin_prefetch(at + b, 1);
  }

  void release(std::uint32_t i) { free_.push_back(i); }
  /// Values in use and released: the bound of all indices.
  std::uint32_t size() const { return size_; }
  std::size_t in_use() const { return size_ - free_.size(); }
  std::size_t bytes() const {
    return chunks_.size() * (kMask + 1) * sizeof(T) + free_.capacity() * sizeof(std::uint32_t);
  }

 private:
  static constexpr std::uint32_t kBits = 12;
  static constexpr std::uint32_t kMask = (1u << kBits) - 1;
  std::vector<std::unique_ptr<T[]>> chunks_;
  std::vector<std::uint32_t> free_;
  std::uint32_t size_ = 0;
};

}  // namespace zloam
