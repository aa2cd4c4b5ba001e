// Reads capture files, and frames of every link type.
#include <fcntl.h>
#include <sys/mman.h>
#include <unistd.h>

#include <cstdlib>
#include <string>

#include "driver/io/link_layer.hpp"
#include "driver/io/packet_source.hpp"

using namespace zloam::driver;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::span<const std::uint8_t> bytes(data, size);
  for (const int link_type : {0, 1, 12, 101, 108, 113, 228, 276}) {
    Datagram datagram;
    IpFragments fragments;
    if (parse_frame(link_type, bytes, fragments, datagram) != FrameKind::kUdp) continue;
    const bool inside = datagram.payload.data() >= data &&
                        datagram.payload.data() + datagram.payload.size() <= data + size;
    if (!inside) std::abort();
  }
  const int fd = memfd_create("capture", 0);
  if (fd < 0 || write(fd, data, size) != static_cast<ssize_t>(size)) std::abort();
  try {
    const auto source = open_pcap("/proc/self/fd/" + std::to_string(fd));
    Datagram datagram;
    while (source->next(datagram, 0) == Read::kDatagram) {
    }
  } catch (const SourceError&) {
  }
  close(fd);
  return 0;
}
