// Decodes position packets and the NMEA sentences in them.
#include "driver/velodyne/decoder.hpp"
#include "driver/velodyne/position.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace zloam::driver;
  using namespace zloam::driver::velodyne;
  std::vector<std::uint8_t> payload(data, data + size);
  parse_position(payload);
  payload.resize(kPositionPacketBytes);
  if (const auto packet = parse_position(payload)) parse_rmc(packet->nmea);
  return 0;
}
