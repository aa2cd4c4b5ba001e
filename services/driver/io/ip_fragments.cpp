#include "driver/io/ip_fragments.hpp"

#include <algorithm>
#include <cstdlib>

namespace zloam::driver {
namespace {

// Numbers of datagrams are used again after 65536 of them, half a minute for a fast sensor: parts
// that are further apart are not of one datagram (RFC 791, section 3.2: a timer of 15 s).
constexpr std::int64_t kLongestNs = 15'000'000'000;

/// 0: unknown.
bool far_apart(std::int64_t a_ns, std::int64_t b_ns) {
  return a_ns != 0 && b_ns != 0 && std::abs(a_ns - b_ns) > kLongestNs;
}

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
  const bool expired = found != open_.end() && far_apart(received_ns, found->received_ns);
  if (found != open_.end() && !expired) return *found;
  if (!expired) found = open_.begin();
  if (expired || open_.size() == kMostOpen) {
    incomplete_ += !found->again;
    open_.erase(found);
  }
  const bool again = std::any_of(done_.begin(), done_.end(), [&](const Done& done) {
    return done.id == id && !far_apart(received_ns, done.received_ns);
  });
  return open_.emplace_back(Datagram{id, received_ns, again, {}, {}, 0});
}

std::span<const std::uint8_t> IpFragments::take(Datagram& datagram) {
  whole_ = std::move(datagram.bytes);
  if (done_.size() == kMostOpen) done_.pop_front();
  const Id id = datagram.id;
  done_.push_back({id, datagram.received_ns});
  std::erase_if(open_, [&](const Datagram& other) { return other.id == id; });
  return whole_;
}

std::uint64_t IpFragments::incomplete() const {
  const auto open = std::count_if(open_.begin(), open_.end(),
                                  [](const Datagram& datagram) { return !datagram.again; });
  return incomplete_ + static_cast<std::uint64_t>(open);
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
  return whole ? take(datagram) : std::span<const std::uint8_t>();
}

}  // namespace zloam::driver
