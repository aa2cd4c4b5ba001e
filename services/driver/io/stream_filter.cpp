#include "driver/io/stream_filter.hpp"

#include "driver/velodyne/decoder.hpp"

namespace zloam::driver {

DatagramKind StreamFilter::classify(const Datagram& datagram) {
  const std::size_t size = datagram.payload.size();
  if (sender_ != 0 && datagram.sender != 0 && datagram.sender != sender_) return stranger();
  if (size == kPositionPacketBytes) return DatagramKind::kPosition;
  const bool own_port = port_ == 0 || datagram.port == 0 || datagram.port == port_;
  if (!own_port) return stranger();
  if (size != kDataPacketBytes) {
    const bool surely_ours = locked_ || (port_ != 0 && datagram.port == port_);
    return surely_ours ? DatagramKind::kMalformed : stranger();
  }
  // From now on only this sensor, so that two in one capture are not mixed.
  if (!locked_) {
    locked_ = true;
    sender_ = datagram.sender;
    port_ = datagram.port;
  }
  return DatagramKind::kData;
}

}  // namespace zloam::driver
