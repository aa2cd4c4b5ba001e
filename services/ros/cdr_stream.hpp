#pragma once
// Plain CDR (OMG DDSI-RTPS 2.5, section 10.2; CORBA 3.4, section 9.3): a header of four bytes, then
// each number at an offset behind the header that is a multiple of its size. Not eProsima Fast CDR,
// because versions 1.0 and 2.2 leave uninitialized heap memory in the padding.

#include <bit>
#include <concepts>
#include <cstdint>
#include <cstring>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace zloam::ros {

inline constexpr std::size_t kCdrHeader = 4;

template <class T>
concept CdrNumber = std::integral<T> || std::floating_point<T>;

/// Writes little endian; padding is zero.
class CdrWriter {
 public:
  explicit CdrWriter(std::size_t expected) {
    static_assert(std::endian::native == std::endian::little);
    bytes_.reserve(expected + kCdrHeader);
    bytes_ = {0, 1, 0, 0};
  }

  template <CdrNumber T>
  CdrWriter& operator<<(T value) {
    const std::size_t at = (bytes_.size() - kCdrHeader + sizeof(T) - 1) / sizeof(T) * sizeof(T);
    bytes_.resize(kCdrHeader + at + sizeof(T));
    std::memcpy(bytes_.data() + kCdrHeader + at, &value, sizeof(T));
    return *this;
  }
  CdrWriter& operator<<(std::string_view text) {
    raw(text.data(), text.size() + 1, text.size());
    return *this;
  }
  /// Writes a sequence's length.
  void count(std::size_t n) { *this << static_cast<std::uint32_t>(n); }
  /// Writes a sequence of octets.
  void octets(const void* data, std::size_t size) { raw(data, size, size); }

  std::vector<std::uint8_t> take() { return std::move(bytes_); }

 private:
  void raw(const void* data, std::size_t counted, std::size_t size) {
    count(counted);
    const std::size_t at = bytes_.size();
    bytes_.resize(at + counted);
    if (size > 0) std::memcpy(bytes_.data() + at, data, size);
  }

  std::vector<std::uint8_t> bytes_;
};

/// Reads either byte order. A value beyond the end is read as zero, and ok() is false from then on.
class CdrReader {
 public:
  explicit CdrReader(std::span<const std::uint8_t> bytes) {
    ok_ = bytes.size() >= kCdrHeader && bytes[0] == 0 && bytes[1] <= 1;
    if (!ok_) return;
    swapped_ = bytes[1] == 0;
    bytes_ = bytes.subspan(kCdrHeader);
  }

  bool ok() const { return ok_; }

  template <CdrNumber T>
  CdrReader& operator>>(T& value) {
    value = {};
    const std::size_t at = (at_ + sizeof(T) - 1) / sizeof(T) * sizeof(T);
    ok_ = ok_ && at + sizeof(T) <= bytes_.size();
    if (!ok_) return *this;
    std::uint8_t raw[sizeof(T)];
    for (std::size_t i = 0; i < sizeof(T); ++i) {
      raw[swapped_ ? sizeof(T) - 1 - i : i] = bytes_[at + i];
    }
    std::memcpy(&value, raw, sizeof(T));
    at_ = at + sizeof(T);
    return *this;
  }
  /// Reads a string, without its terminating zero.
  CdrReader& operator>>(std::string& text) {
    std::uint32_t size = 0;
    *this >> size;
    ok_ = ok_ && size > 0 && size <= bytes_.size() - at_;
    text.clear();
    if (!ok_) return *this;
    text.assign(reinterpret_cast<const char*>(bytes_.data()) + at_, size - 1);
    at_ += size;
    return *this;
  }

 private:
  std::span<const std::uint8_t> bytes_;
  std::size_t at_ = 0;
  bool swapped_ = false;
  bool ok_ = false;
};

}  // namespace zloam::ros
