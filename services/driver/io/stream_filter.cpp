#include "driver/io/stream_filter.hpp"

#include <algorithm>

namespace zloam::driver {
namespace {

// The sensor is silent if no packet of it arrived for this long, or, without receive times, during
// this many packets of a newcomer.
constexpr std::int64_t kSilentNs = 200'000'000;
constexpr int kNewcomerPackets = 16;
constexpr int kNewcomerPacketsWithoutTimes = 256;
constexpr std::size_t kMostOthers = 64;

}  // namespace

DatagramKind StreamFilter::classify(const Datagram& datagram) {
  if (!of_sensor(datagram)) return other_sender(datagram);
  const PacketKind kind = makers_.kind(datagram.payload);
  if (kind == PacketKind::kPosition) return DatagramKind::kPosition;
  if (kind == PacketKind::kImu) return DatagramKind::kImu;
  const bool own_port = port_ == 0 || datagram.port == 0 || datagram.port == port_;
  if (!own_port) return stranger();
  if (kind == PacketKind::kData) return data(datagram);
  const bool surely_ours = locked_ || (port_ != 0 && datagram.port == port_);
  return surely_ours ? DatagramKind::kMalformed : stranger();
}

DatagramKind StreamFilter::data(const Datagram& datagram) {
  // From now on only this sensor is accepted, so that two sensors in one capture are not mixed.
  if (!locked_) {
    locked_ = true;
    makers_.settle(datagram.payload);
    sender_ = first_sender_ = datagram.sender;
    port_ = datagram.port;
  }
  no_newcomer();
  last_received_ns_ = datagram.received_ns;
  return DatagramKind::kData;
}

DatagramKind StreamFilter::other_sender(const Datagram& datagram) {
  const bool data_packet = makers_.kind(datagram.payload) == PacketKind::kData &&
                           (port_ == 0 || datagram.port == 0 || datagram.port == port_);
  if (!data_packet) return stranger();
  other_sender_ = datagram.sender;
  if (!any_sender_ || !locked_) return stranger();
  if (datagram.sender == first_sender_) {
    newcomer_ = sender_;
    no_newcomer();
    sender_ = first_sender_;
    last_received_ns_ = datagram.received_ns;
    return DatagramKind::kReturned;
  }
  if (std::find(others_.begin(), others_.end(), datagram.sender) != others_.end()) {
    if (++packets_of_others_ == kNewcomerPackets) second_sensor_ = datagram.sender;
    return stranger();
  }
  if (newcomer_ != datagram.sender) {
    no_newcomer();
    newcomer_ = datagram.sender;
  }
  ++newcomer_packets_;
  if (!silent_until(datagram.received_ns)) return DatagramKind::kNewcomer;
  sender_ = newcomer_;
  newcomer_ = 0;
  newcomer_packets_ = 0;
  last_received_ns_ = datagram.received_ns;
  return DatagramKind::kAdopted;
}

/// Marks the newcomer, if there is one, as another sensor.
void StreamFilter::no_newcomer() {
  if (newcomer_ == 0) return;
  if (others_.size() == kMostOthers) others_.erase(others_.begin());
  others_.push_back(newcomer_);
  foreign_ += static_cast<std::uint64_t>(newcomer_packets_);
  newcomer_ = 0;
  newcomer_packets_ = 0;
}

bool StreamFilter::silent_until(std::int64_t received_ns) const {
  const bool times_known = last_received_ns_ != 0 && received_ns > last_received_ns_;
  return times_known
             ? newcomer_packets_ >= kNewcomerPackets && received_ns - last_received_ns_ >= kSilentNs
             : newcomer_packets_ >= kNewcomerPacketsWithoutTimes;
}

}  // namespace zloam::driver
