#pragma once
// All makers whose packets are decoded, and which of them a stream is of.

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "driver/decoder/maker.hpp"

namespace zloam::driver {

/// Models that a configuration can name, as on their labels.
std::vector<std::string> known_models();
/// Without regard to case, spaces and signs.
bool is_known_model(std::string_view name);

class Makers {
 public:
  explicit Makers(const DecodingOptions& options);

  /// Before the stream is settled a packet of any maker counts.
  PacketKind kind(std::span<const std::uint8_t> payload) const;
  /// From now on the stream is of the maker of this data packet.
  void settle(std::span<const std::uint8_t> data_packet);
  /// The stream's maker, or the one that is taken as long as there was no data packet.
  const Maker& maker() const;

  /// Why no maker knows the options' metadata; empty: one does.
  std::string metadata_error() const;

 private:
  std::vector<std::unique_ptr<const Maker>> makers_;
  /// by driver.model
  const Maker* named_ = nullptr;
  const Maker* settled_ = nullptr;
};

}  // namespace zloam::driver
