#pragma once
// Decides whose messages the store takes: those of the mapping that is present and confirms them.
// Storing another map's tile makes a map obsolete for good, and the greatest instant wins for ever,
// so neither depends on a put alone: a message that is not from the known publisher, or is far from
// its other poses, is held until the publisher was asked (docs/protocol.md, section 15).

#include <compare>
#include <cstdint>
#include <optional>
#include <string>

namespace zloam::store {

/// Source fields of a message's header.
struct Source {
  std::uint64_t run = 0;
  std::uint64_t map_id = 0;
  std::uint32_t term = 0;
  std::string instance;
  auto operator<=>(const Source&) const = default;
};

class LivePublisher {
 public:
  /// A mapping's answer about one of its poses; ascending, the last answer counts.
  void answered(const Source& source, std::int64_t instant_ns);

  bool believes(const Source& source) const { return source_ == source; }
  /// Also requires that the instant is near the others.
  bool believes(const Source& source, std::int64_t instant_ns) const;
  /// A pose of this publisher was stored.
  void stored(std::int64_t instant_ns);
  /// Whether a pose on disk has a later instant than any pose of this publisher can have.
  bool is_beyond(std::int64_t instant_ns) const;

 private:
  std::optional<Source> source_;
  std::int64_t first_ns_ = 0, last_ns_ = 0;
};

}  // namespace zloam::store
