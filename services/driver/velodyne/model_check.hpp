#pragma once
// Whether the packets' timing fits the model they claim to be of. Captures of one model with the
// product byte of another exist.

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "driver/velodyne/decoder.hpp"

namespace zloam::driver {

/// How many packets tell the timing.
inline constexpr std::size_t kTimingPackets = 7;

/// The declared model when the packets claim another, their period does not fit the claim, and it
/// does fit the declared one; nothing otherwise. payloads: the first packets of a stream.
std::optional<Model> model_by_timing(const std::vector<std::vector<std::uint8_t>>& payloads,
                                     std::optional<Model> declared);

}  // namespace zloam::driver
