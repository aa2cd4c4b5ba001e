#include "driver/io/look_ahead.hpp"

#include <algorithm>
#include <cstddef>
#include <limits>

#include "driver/sweep/clock.hpp"

namespace zloam::driver {
namespace {

constexpr std::int64_t kLookAheadNs = 1'500'000'000;
// Limit by the receive times: the stamps of packets whose metadata are missing tell no time.
constexpr std::int64_t kMostReceivedNs = 2 * kLookAheadNs;
// Enough for 1.5 s of any model, and for other datagrams between them. The times of other sensors'
// packets do not count: where the named sensor sends nothing, these limits alone end the reading.
constexpr std::size_t kMostKept = 65'536;
constexpr std::size_t kMostKeptBytes = std::size_t{256} << 20;
// If the first packet is late by less than this against the others, its receive time is used as it
// is.
constexpr std::int64_t kLateStartNs = 50'000'000;

}  // namespace

LookAhead::LookAhead(PacketSource& source, const DecodingOptions& options, std::uint32_t sender)
    : source_(source), makers_(options), sender_(sender) {
  Datagram datagram;
  bool enough = false;
  std::size_t bytes = 0;
  while (!enough && kept_.size() < kMostKept && bytes < kMostKeptBytes) {
    if (source_.next(datagram, 0) != Read::kDatagram) {
      ended_ = true;
      break;
    }
    kept_.push_back({{datagram.payload.begin(), datagram.payload.end()}, datagram});
    bytes += datagram.payload.size();
    enough = add(datagram);
  }
  first_received_ns_ = least_late();
}

/// Whether enough has been read.
bool LookAhead::add(const Datagram& datagram) {
  const bool of_other = sender_ != 0 && datagram.sender != 0 && datagram.sender != sender_;
  if (of_other || makers_.kind(datagram.payload) != PacketKind::kData) return false;
  makers_.settle(datagram.payload);
  if (datagram.received_ns == 0) return true;
  const std::uint32_t toh_us = makers_.maker().toh_us(datagram.payload);
  if (arrivals_.empty()) {
    sender_ = datagram.sender;
    first_toh_us_ = toh_us;
  }
  arrivals_.push_back({datagram.received_ns, 1000 * toh_difference_us(toh_us, first_toh_us_)});
  return arrivals_.back().after_ns >= kLookAheadNs ||
         datagram.received_ns - arrivals_.front().received_ns >= kMostReceivedNs;
}

std::int64_t LookAhead::least_late() const {
  if (arrivals_.size() < 2) return 0;
  const std::int64_t own_ns = arrivals_.front().received_ns;
  // Among truncated receive times, only those just after a change are precise.
  const bool coarse = arrivals_[1].received_ns == own_ns;
  std::int64_t least_ns = coarse ? std::numeric_limits<std::int64_t>::max() : own_ns;
  for (std::size_t i = 1; i < arrivals_.size(); ++i) {
    const auto [received_ns, after_ns] = arrivals_[i];
    const bool changed = received_ns > arrivals_[i - 1].received_ns;
    if (after_ns <= 0 || after_ns > 2 * kLookAheadNs || (coarse && !changed)) continue;
    least_ns = std::min(least_ns, received_ns - after_ns);
  }
  if (least_ns == std::numeric_limits<std::int64_t>::max()) return 0;
  return coarse || own_ns - least_ns > kLateStartNs ? least_ns : 0;
}

Read LookAhead::next(Datagram& datagram) {
  if (kept_.empty()) return ended_ ? Read::kEnd : source_.next(datagram, 0);
  current_ = std::move(kept_.front());
  kept_.pop_front();
  datagram = current_.datagram;
  datagram.payload = current_.payload;
  return Read::kDatagram;
}

}  // namespace zloam::driver
