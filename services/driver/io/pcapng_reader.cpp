#include "driver/io/pcapng_reader.hpp"

#include <algorithm>
#include <bit>
#include <cerrno>
#include <cstring>

#include "driver/io/packet_source.hpp"

namespace zloam::driver {
namespace {

constexpr std::uint32_t kSection = 0x0A0D0D0A;
constexpr std::uint32_t kInterface = 1;
constexpr std::uint32_t kOldPacket = 2;
constexpr std::uint32_t kSimplePacket = 3;
constexpr std::uint32_t kPacket = 6;
constexpr std::uint32_t kByteOrder = 0x1A2B3C4D;
constexpr unsigned kResolution = 9;
constexpr unsigned kTimeOffset = 14;
// A block with a captured frame is shorter.
constexpr std::uint32_t kMostBlockBytes = 16U << 20;
constexpr std::size_t kMostInterfaces = 4096;
constexpr std::size_t kFrame = 12;  // type, length, and the length repeated at the end

constexpr std::uint32_t swapped(std::uint32_t v) {
  return v >> 24 | (v >> 8 & 0xFF00U) | (v << 8 & 0xFF0000U) | v << 24;
}

std::size_t padded(std::size_t bytes) { return (bytes + 3) / 4 * 4; }

}  // namespace

static_assert(std::endian::native == std::endian::little);

bool PcapngReader::is_pcapng(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  std::uint32_t type = 0;
  file.read(reinterpret_cast<char*>(&type), sizeof type);
  return file && type == kSection;
}

PcapngReader::PcapngReader(const std::string& path) : file_(path, std::ios::binary) {
  if (!file_) throw SourceError(path + ": " + std::strerror(errno));
}

std::uint16_t PcapngReader::u16(std::size_t at) const {
  std::uint16_t value = 0;
  std::memcpy(&value, body_.data() + at, sizeof value);
  return swapped_ ? static_cast<std::uint16_t>(value >> 8 | value << 8) : value;
}

std::uint32_t PcapngReader::u32(std::size_t at) const {
  std::uint32_t value = 0;
  std::memcpy(&value, body_.data() + at, sizeof value);
  return swapped_ ? swapped(value) : value;
}

bool PcapngReader::fail(const std::string& why) {
  error_ = why;
  return false;
}

/// Appends this many bytes of the file to the block's body.
bool PcapngReader::take(std::size_t bytes) {
  const std::size_t had = body_.size();
  body_.resize(had + bytes);
  file_.read(reinterpret_cast<char*>(body_.data() + had), static_cast<std::streamsize>(bytes));
  return file_.good() || fail("a block is cut off");
}

/// Reads the next block, without its two lengths; false at the end.
bool PcapngReader::read_block(std::uint32_t& type) {
  body_.clear();
  if (file_.peek() == std::ifstream::traits_type::eof()) return false;
  if (!take(8)) return false;
  type = u32(0);
  if (type == kSection) {
    // The byte order of a section's length is known only from the magic number behind it.
    if (!take(4)) return false;
    swapped_ = false;
    if (u32(8) != kByteOrder && swapped(u32(8)) != kByteOrder)
      return fail("a section without order");
    swapped_ = u32(8) != kByteOrder;
  }
  const std::uint32_t length = u32(4);
  if (length % 4 != 0 || length < kFrame || length < body_.size() + 4 || length > kMostBlockBytes) {
    return fail("a block of " + std::to_string(length) + " bytes");
  }
  const std::size_t already = body_.size();
  if (!take(length - already)) return false;
  if (u32(length - 4) != length) return fail("a block whose two lengths differ");
  body_.resize(length - 4);
  body_.erase(body_.begin(), body_.begin() + 8);
  return true;
}

bool PcapngReader::section() {
  interfaces_.clear();
  return body_.size() >= 16 || fail("a section that is too short");
}

void PcapngReader::interface_option(unsigned code, std::span<const std::uint8_t> value,
                                    Interface& interface) {
  if (code == kResolution && !value.empty()) {
    interface.binary = (value[0] & 0x80U) != 0;
    interface.exponent = value[0] & 0x7F;
  } else if (code == kTimeOffset && value.size() >= 8) {
    const auto at = static_cast<std::size_t>(value.data() - body_.data());
    const std::uint64_t low = u32(swapped_ ? at + 4 : at);
    const std::uint64_t high = u32(swapped_ ? at : at + 4);
    interface.offset_s = static_cast<std::int64_t>(high << 32 | low);
  }
}

bool PcapngReader::interface() {
  if (body_.size() < 8) return fail("an interface that is too short");
  if (interfaces_.size() == kMostInterfaces) return fail("too many interfaces");
  Interface interface { u16(0), u32(4), false, 6, 0 };
  for (std::size_t at = 8; at + 4 <= body_.size();) {
    const unsigned code = u16(at);
    const std::size_t length = u16(at + 2);
    if (code == 0 || at + 4 + length > body_.size()) break;
    interface_option(code, std::span(body_).subspan(at + 4, length), interface);
    at += 4 + padded(length);
  }
  interfaces_.push_back(interface);
  return true;
}

std::int64_t PcapngReader::time_ns(const Interface& interface, std::uint64_t units) const {
  // 128 bits hold the product without overflow.
  __extension__ using Wide = unsigned __int128;
  Wide per_second = 1;
  for (int i = 0; i < interface.exponent; ++i) {
    per_second *= interface.binary ? 2 : 10;
    if (per_second > Wide{1} << 64) return 0;
  }
  const Wide ns = Wide{units} * 1'000'000'000U / per_second;
  constexpr Wide kMostNs = Wide{1} << 62;
  constexpr std::int64_t kMostS = 4'000'000'000;
  if (ns > kMostNs || interface.offset_s > kMostS || interface.offset_s < -kMostS) return 0;
  return static_cast<std::int64_t>(ns) + interface.offset_s * 1'000'000'000;
}

bool PcapngReader::packet(std::uint32_t type, CapturedFrame& frame) {
  const bool simple = type == kSimplePacket;
  const std::size_t head = simple ? 4 : 20;
  if (body_.size() < head) return fail("a packet that is too short");
  const std::size_t index = simple ? 0 : type == kPacket ? u32(0) : u16(0);
  if (index >= interfaces_.size()) return fail("a packet of an interface that is not declared");
  const Interface& interface = interfaces_[index];
  std::size_t bytes = simple ? u32(0) : u32(12);
  if (simple && interface.snap_bytes != 0)
    bytes = std::min<std::size_t>(bytes, interface.snap_bytes);
  if (bytes > body_.size() - head) return fail("a packet that is longer than its block");
  frame.link_type = interface.link_type;
  frame.data = std::span(body_).subspan(head, bytes);
  frame.received_ns =
      simple ? 0 : time_ns(interface, static_cast<std::uint64_t>(u32(4)) << 32 | u32(8));
  return true;
}

bool PcapngReader::next(CapturedFrame& frame) {
  std::uint32_t type = 0;
  while (error_.empty() && read_block(type)) {
    switch (type) {
      case kSection:
        if (!section()) return false;
        break;
      case kInterface:
        if (!interface()) return false;
        break;
      case kOldPacket:
      case kSimplePacket:
      case kPacket:
        return packet(type, frame);
      default:
        break;  // names, statistics, custom blocks
    }
  }
  return false;
}

}  // namespace zloam::driver
