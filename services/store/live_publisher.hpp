#pragma once
// Whose messages the store takes: those of the mapping that is there and answers for them. A map is
// put away for good when another one's tile is stored, and the greatest instant wins for ever, so
// neither depends on a put alone: what does not come from the publisher that is known, or is far
// from its other poses, is held until the publisher was asked (docs/protocol.md, section 15).

#include <compare>
#include <cstdint>
#include <optional>
#include <string>

namespace zloam::store {

/// Of a message's header.
struct Source {
  std::uint64_t run = 0;
  std::uint64_t map_id = 0;
  std::uint32_t term = 0;
  std::string instance;
  auto operator<=>(const Source&) const = default;
};

class LivePublisher {
 public:
  /// What a mapping answered of one of its poses; ascending, the last answer counts.
  void answered(const Source& source, std::int64_t instant_ns);

  bool believes(const Source& source) const { return source_ == source; }
  /// Also that the instant is near the others.
  bool believes(const Source& source, std::int64_t instant_ns) const;
  /// Such a pose was stored.
  void stored(std::int64_t instant_ns);
  /// Of a pose on disk: that it can't be older than what this publisher says.
  bool is_beyond(std::int64_t instant_ns) const;

 private:
  std::optional<Source> source_;
  std::int64_t first_ns_ = 0, last_ns_ = 0;
};

}  // namespace zloam::store
