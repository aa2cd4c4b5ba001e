#include "driver/io/ip_fragments.hpp"

#include <algorithm>

namespace zloam::driver {

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

std::span<const std::uint8_t> IpFragments::add(const Id& id, std::size_t offset, bool more,
                                               std::span<const std::uint8_t> part) {
  if (part.empty() || offset + part.size() > kMostBytes) return {};
  auto found = std::find_if(open_.begin(), open_.end(),
                            [&](const Datagram& datagram) { return datagram.id == id; });
  if (found == open_.end()) {
    if (open_.size() == kMostOpen) {
      ++incomplete_;
      open_.pop_front();
    }
    open_.push_back({id, {}, {}, 0});
    found = open_.end() - 1;
  }
  put(*found, offset, part);
  if (!more) found->size = offset + part.size();
  const bool whole = found->size != 0 && found->there.size() == 1 &&
                     found->there.front() == std::pair<std::size_t, std::size_t>{0, found->size};
  if (!whole) return {};
  whole_ = std::move(found->bytes);
  open_.erase(found);
  return whole_;
}

}  // namespace zloam::driver
