#include "driver/io/ip_fragments.hpp"

#include <algorithm>
#include <cstdlib>

namespace zloam::driver {
namespace {

// Numbers of datagrams are used again after 65536 of them, half a minute for a fast sensor: parts
// that are further apart are not of one datagram (RFC 791, section 3.2: a timer of 15 s).
constexpr std::int64_t kLongestNs = 15'000'000'000;

}  // namespace

void IpFragments::put(Datagram& datagram, std::size_t offset, std::span<const std::uint8_t> part) {
  const std::size_t end = offset + part.size();
  datagram.bytes.resize(std::max(datagram.bytes.size(), end));
  std::copy(part.begin(), part.end(), datagram.bytes.begin() + static_cast<std::ptrdiff_t>(offset));
  auto& there = datagram.there;
  there.insert(std::lower_bound(there.begin(), there.end(), std::pair{offset, end}), {offset, end});
  std::size_t last = 0;
  for (std::size_t i = 1; i < there.size(); ++i) {
    if (there[i].first <= there[last].second) {
      there[last].second = std::max(there[last].second, there[i].second);
    } else {
      there[++last] = there[i];
    }
  }
  there.resize(last + 1);
}

/// The datagram of this identity that parts received at this time belong to.
IpFragments::Datagram& IpFragments::open(const Id& id, std::int64_t received_ns) {
  auto found = std::find_if(open_.begin(), open_.end(),
                            [&](const Datagram& datagram) { return datagram.id == id; });
  const bool expired = found != open_.end() && received_ns != 0 && found->received_ns != 0 &&
                       std::abs(received_ns - found->received_ns) > kLongestNs;
  if (found != open_.end() && !expired) return *found;
  if (!expired) found = open_.begin();
  if (expired || open_.size() == kMostOpen) {
    ++incomplete_;
    open_.erase(found);
  }
  return open_.emplace_back(Datagram{id, received_ns, {}, {}, 0});
}

std::span<const std::uint8_t> IpFragments::add(const Id& id, std::int64_t received_ns,
                                               std::size_t offset, bool more,
                                               std::span<const std::uint8_t> part) {
  if (part.empty() || offset + part.size() > kMostBytes) return {};
  Datagram& datagram = open(id, received_ns);
  put(datagram, offset, part);
  if (!more) datagram.size = offset + part.size();
  const std::pair<std::size_t, std::size_t> all{0, datagram.size};
  const bool whole =
      datagram.size != 0 && datagram.there.size() == 1 && datagram.there.front() == all;
  if (!whole) return {};
  whole_ = std::move(datagram.bytes);
  std::erase_if(open_, [&](const Datagram& other) { return other.id == id; });
  return whole_;
}

}  // namespace zloam::driver
