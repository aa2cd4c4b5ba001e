#pragma once
// Reassembles datagrams from IPv4 fragments (RFC 791, section 3.2): one bounded table.

#include <cstdint>
#include <deque>
#include <span>
#include <utility>
#include <vector>

namespace zloam::driver {

class IpFragments {
 public:
  /// Identity of a datagram's fragments.
  struct Id {
    std::uint32_t sender = 0;
    std::uint32_t receiver = 0;
    std::uint16_t number = 0;
    bool operator==(const Id&) const = default;
  };

  /// `part` begins at `offset` of the datagram's bytes. received_ns: 0: unknown. Returns the whole
  /// datagram if this was the last missing part, valid until the next call; otherwise nothing.
  std::span<const std::uint8_t> add(const Id& id, std::int64_t received_ns, std::size_t offset,
                                    bool more, std::span<const std::uint8_t> part);

  /// Datagrams whose missing parts did not arrive in time. Parts of a datagram that was whole
  /// before came twice.
  std::uint64_t incomplete() const;

 private:
  static constexpr std::size_t kMostOpen = 64;
  static constexpr std::size_t kMostBytes = 65'535;

  struct Datagram {
    Id id;
    /// of the part that arrived first
    std::int64_t received_ns = 0;
    /// it was whole before
    bool again = false;
    std::vector<std::uint8_t> bytes;
    /// from, to of the received parts, ascending, not overlapping
    std::vector<std::pair<std::size_t, std::size_t>> there;
    /// 0: the last part has not arrived
    std::size_t size = 0;
  };

  struct Done {
    Id id;
    std::int64_t received_ns;
  };

  static void put(Datagram& datagram, std::size_t offset, std::span<const std::uint8_t> part);
  Datagram& open(const Id& id, std::int64_t received_ns);
  std::span<const std::uint8_t> take(Datagram& datagram);

  std::deque<Datagram> open_;
  /// those that were whole last
  std::deque<Done> done_;
  std::vector<std::uint8_t> whole_;
  std::uint64_t incomplete_ = 0;
};

}  // namespace zloam::driver
