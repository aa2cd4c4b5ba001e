#pragma once
// All makers whose packets are decoded; finds the maker of a stream.

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
/// Ignores case, spaces and punctuation.
bool is_known_model(std::string_view name);

class Makers {
 public:
  explicit Makers(const DecodingOptions& options);

  /// Before settle() a packet of any maker counts.
  PacketKind kind(std::span<const std::uint8_t> payload) const;
  /// Fixes the stream's maker to that of this data packet.
  void settle(std::span<const std::uint8_t> data_packet);
  /// The stream's maker, or the assumed one before the first data packet.
  const Maker& maker() const;

  /// Why no maker can read the options' metadata; empty: one can.
  std::string metadata_error() const;

 private:
  std::vector<std::unique_ptr<const Maker>> makers_;
  /// by driver.model
  const Maker* named_ = nullptr;
  const Maker* settled_ = nullptr;
};

}  // namespace zloam::driver
