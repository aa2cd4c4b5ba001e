// Decodes data packets: any bytes in any order must give valid sweeps (check()).
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>

#include "driver/hesai/decoder.hpp"
#include "driver/sweep/assembler.hpp"
#include "driver/velodyne/decoder.hpp"

using namespace zloam::driver;

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

namespace {

/// The decoder for one manufacturer's packets, and a function that changes any bytes so that they
/// pass the decoder's first checks.
struct Stream {
  std::unique_ptr<PacketDecoder> decoder;
  void (*mend)(std::vector<std::uint8_t>& payload, std::size_t any);
};

void mend_velodyne(std::vector<std::uint8_t>& payload, std::size_t any) {
  payload.resize(velodyne::kDataPacketBytes);
  for (std::size_t k = 0; k < velodyne::kBlocksPerPacket; ++k) {
    payload[100 * k] = 0xFF;
    payload[100 * k + 1] = 0xEE;
  }
  payload[1204] = static_cast<std::uint8_t>(0x37 + any % 3);
  payload[1205] = 0x22;
}

constexpr std::array<std::uint8_t, hesai::kHeaderBytes> kHesaiHeader = {0xEE, 0xFF, 6, 1, 0, 0,
                                                                        32,   8,    0, 4, 2, 1};

void mend_hesai(std::vector<std::uint8_t>& payload, std::size_t any) {
  constexpr std::array<std::uint8_t, 6> kModes = {0x33, 0x37, 0x38, 0x39, 0x3B, 0x3C};
  const hesai::Header header = *hesai::header_of(kHesaiHeader);
  payload.resize(header.packet_bytes());
  std::copy(kHesaiHeader.begin(), kHesaiHeader.end(), payload.begin());
  payload[header.tail_at() + 10] = kModes[any % kModes.size()];
  payload[header.tail_at() + 17] %= 60;
  payload[header.tail_at() + 18] %= 60;
  payload[header.tail_at() + 22] = 0;
  payload[header.tail_at() + 21] %= 15;
}

Stream stream_by(std::uint8_t choice) {
  if (choice >= 5 && (choice & 4) != 0) {
    DecodingOptions options;
    options.dual_returns = static_cast<DualReturns>(choice >> 6);
    if ((choice & 16) != 0) options.max_range_m = 20.0;
    const hesai::Header header = *hesai::header_of(kHesaiHeader);
    return {std::make_unique<hesai::Decoder>(header, hesai::designed_beams(header.lasers), options),
            mend_hesai};
  }
  velodyne::DecoderConfig config;
  if (choice < 5) {
    config.model = static_cast<velodyne::Model>(choice);
  } else {
    config.dual_returns = static_cast<DualReturns>(choice >> 6);
    if ((choice & 16) != 0) config.max_range_m = 20.0;
  }
  return {std::make_unique<velodyne::Decoder>(config), mend_velodyne};
}

}  // namespace

/// The first byte selects a forced model, or else the manufacturer and the settings. Then follow
/// packets: two bytes of length and the payload. Half of them are mended to pass the first checks.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  AssemblerConfig config;
  if (data[0] >= 5) {
    if ((data[0] & 32) != 0) config.mask.sectors = {{350.0, 10.0}};
    if ((data[0] & 8) != 0) config.seam_azimuth_deg = 123.4;
  }
  Stream stream = stream_by(data[0]);
  SweepAssembler assembler(std::move(stream.decoder), config);
  std::size_t at = 1;
  DecodedSweep sweep;
  std::int64_t received_ns = data[0] % 2 == 0 ? 0 : 1'700'000'000'000'000'000;
  while (at + 2 <= size) {
    const std::size_t wanted = (data[at] | data[at + 1] << 8) % 1300U;
    at += 2;
    const std::size_t length = std::min(wanted, size - at);
    std::vector<std::uint8_t> payload(data + at, data + at + length);
    at += length;
    if (wanted % 2 == 0) stream.mend(payload, wanted / 2);
    assembler.add(payload, received_ns);
    if (received_ns != 0) received_ns += 1'327'104;
    while (assembler.take(sweep)) check(sweep);
  }
  assembler.flush();
  while (assembler.take(sweep)) check(sweep);
  return 0;
}
