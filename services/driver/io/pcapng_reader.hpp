#pragma once
// Blocks of a pcapng file (draft-ietf-opsawg-pcapng), each by its own interface: the library that
// reads pcap stops at a second interface of another link type or snap length.

#include <cstdint>
#include <fstream>
#include <span>
#include <string>
#include <vector>

namespace zloam::driver {

struct CapturedFrame {
  int link_type = 0;
  /// valid until the next one is read
  std::span<const std::uint8_t> data;
  /// ns since the Unix epoch; 0: the block has none
  std::int64_t received_ns = 0;
};

class PcapngReader {
 public:
  /// Whether the file begins like a pcapng file.
  static bool is_pcapng(const std::string& path);

  /// Throws SourceError.
  explicit PcapngReader(const std::string& path);

  /// False at the end; error() is set if the file ends early.
  bool next(CapturedFrame& frame);

  const std::string& error() const { return error_; }

 private:
  struct Interface {
    int link_type = 0;
    std::uint32_t snap_bytes = 0;
    /// of one unit of its time stamps: a negative power of 10, or of 2
    bool binary = false;
    int exponent = 6;
    std::int64_t offset_s = 0;
  };

  bool read_block(std::uint32_t& type);
  bool take(std::size_t bytes);
  bool fail(const std::string& why);
  bool section();
  bool interface();
  void interface_option(unsigned code, std::span<const std::uint8_t> value, Interface& interface);
  bool packet(std::uint32_t type, CapturedFrame& frame);
  std::int64_t time_ns(const Interface& interface, std::uint64_t units) const;
  std::uint16_t u16(std::size_t at) const;
  std::uint32_t u32(std::size_t at) const;

  std::ifstream file_;
  bool swapped_ = false;
  std::vector<std::uint8_t> body_;
  std::vector<Interface> interfaces_;
  std::string error_;
};

}  // namespace zloam::driver
