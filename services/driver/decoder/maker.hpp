#pragma once
// Sensors of one maker: recognizes their datagrams and makes a decoder for a stream of them. A new
// maker needs a folder beside this one with such a class, and a line in makers.cpp.

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "common/geometry/imu_reading.hpp"
#include "driver/decoder/nmea.hpp"
#include "driver/decoder/packet_decoder.hpp"

namespace zloam::driver {

/// The user's settings of the decoding, the same for all makers.
struct DecodingOptions {
  /// one of Maker's models; empty: by the packets
  std::string model = {};
  /// model on the sensor's label: detects packets that claim another one wrongly
  std::string declared_model = {};
  /// nothing: by the packets
  std::optional<ReturnMode> return_mode = std::nullopt;
  /// which returns of a pair are given
  DualReturns dual_returns = DualReturns::kTagged;
  /// nearer and farther returns are dropped; both ends are kept. Of the measured distance.
  double min_range_m = 0.0;
  double max_range_m = 1000.0;
  /// the lasers have different origins; most data sets ignore the shift (up to 17 mm)
  bool vertical_offsets = true;
  /// text of the sensor's metadata file, and its source, for messages
  std::string metadata = {};
  std::string metadata_name = {};
};

/// What a datagram is.
enum class PacketKind : std::uint8_t { kForeign, kData, kPosition, kImu };

/// First packets of a stream, in order of arrival.
using FirstPackets = std::vector<std::vector<std::uint8_t>>;

class Maker {
 public:
  Maker() = default;
  virtual ~Maker() = default;
  Maker(const Maker&) = delete;
  Maker& operator=(const Maker&) = delete;

  virtual PacketKind kind(std::span<const std::uint8_t> payload) const = 0;

  /// Sensor's time of a data packet, since the top of its hour.
  virtual std::uint32_t toh_us(std::span<const std::uint8_t> data_packet) const = 0;

  /// Number of data packets that decoder() needs.
  virtual std::size_t packets_to_know() const { return 1; }
  /// Sentences for the user go to remarks.
  virtual std::unique_ptr<PacketDecoder> decoder(const FirstPackets& first,
                                                 std::vector<std::string>& remarks) const = 0;

  /// Content of a packet of kPosition; nothing if it is damaged.
  virtual std::optional<PositionPacket> position(std::span<const std::uint8_t> /*payload*/) const {
    return std::nullopt;
  }
  /// Readings of a packet of kImu in the lidar's axes. Stamps: ns since the top of the sensor's
  /// hour, of the same clock as the data packets'.
  virtual std::vector<ImuReading> imu(std::span<const std::uint8_t> /*payload*/) const {
    return {};
  }

  /// Length of data packets in a file of bare payloads; 0: unknown.
  virtual std::size_t payload_bytes() const = 0;
  /// Name of the maker's kind of metadata file; empty: it has none.
  virtual std::string metadata_kind() const { return {}; }
  /// Whether the options' metadata describe a sensor of this maker.
  virtual bool described() const { return false; }
  /// What is wrong with the options' metadata, if they are of the maker's kind but do not describe
  /// one of its sensors.
  virtual std::string metadata_error() const { return {}; }
};

}  // namespace zloam::driver
