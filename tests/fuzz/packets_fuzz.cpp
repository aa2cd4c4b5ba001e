// Data packets: any bytes, in any order, give sweeps that keep their promises.
#include <cmath>
#include <cstdlib>

#include "driver/sweep/assembler.hpp"
#include "driver/velodyne/decoder.hpp"

using namespace zloam::driver;
using namespace zloam::driver::velodyne;

namespace {

void check(const DecodedSweep& sweep) {
  if (sweep.points.size() != sweep.columns.size()) std::abort();
  std::uint32_t last_ns = 0;
  for (const zloam::Point& p : sweep.points) {
    if (!std::isfinite(p.x) || !std::isfinite(p.y) || !std::isfinite(p.z)) std::abort();
    if (p.ring >= sweep.rings || p.time_ns < last_ns) std::abort();
    last_ns = p.time_ns;
  }
}

}  // namespace

/// First byte: which model is forced, if any, or else what is left out. Then packets: two bytes of
/// length, and the payload; one short of 1206 bytes is filled up with a tail that is right, to get
/// past the first checks.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  DecoderConfig decoder;
  if (data[0] < 5) decoder.model = static_cast<Model>(data[0]);
  AssemblerConfig config;
  if (data[0] >= 5) {
    decoder.dual_returns = static_cast<DualReturns>(data[0] >> 6);
    if ((data[0] & 32) != 0) config.mask.sectors = {{350.0, 10.0}};
    if ((data[0] & 16) != 0) decoder.max_range_m = 20.0;
    if ((data[0] & 8) != 0) config.seam_azimuth_deg = 123.4;
  }
  SweepAssembler assembler(std::make_unique<Decoder>(decoder), config);
  std::size_t at = 1;
  DecodedSweep sweep;
  std::int64_t received_ns = data[0] % 2 == 0 ? 0 : 1'700'000'000'000'000'000;
  while (at + 2 <= size) {
    const std::size_t wanted = (data[at] | data[at + 1] << 8) % 1300U;
    at += 2;
    const std::size_t length = std::min(wanted, size - at);
    std::vector<std::uint8_t> payload(data + at, data + at + length);
    at += length;
    if (wanted % 2 == 0) {
      payload.resize(kDataPacketBytes);
      for (std::size_t k = 0; k < kBlocksPerPacket; ++k) {
        payload[100 * k] = 0xFF;
        payload[100 * k + 1] = 0xEE;
      }
      payload[1204] = static_cast<std::uint8_t>(0x37 + wanted / 2 % 3);
      payload[1205] = 0x22;
    }
    assembler.add(payload, received_ns);
    if (received_ns != 0) received_ns += 1'327'104;
    while (assembler.take(sweep)) check(sweep);
  }
  assembler.flush();
  while (assembler.take(sweep)) check(sweep);
  return 0;
}
