#pragma once
// Whether the packets' timing fits the model that they claim. There are captures of one model with
// the product byte of another.

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "driver/velodyne/decoder.hpp"

namespace zloam::driver::velodyne {

/// Packets needed to measure the timing.
inline constexpr std::size_t kTimingPackets = 7;

/// The declared model when the packets claim another, their period does not fit the claim, and it
/// does fit the declared one; nothing otherwise. payloads: the first packets of a stream.
std::optional<Model> model_by_timing(const std::vector<std::vector<std::uint8_t>>& payloads,
                                     std::optional<Model> declared);

/// Time from one firing group to the next, for a model whose firmware determines it: the published
/// value that fits the packets' stamps, otherwise the measured one. 0 for all other models, and
/// with too few packets. For a VLS-128, packets of 160 us (firmware 5.1.7) and 173.4 us (5.2.3) are
/// published; a recording has 165.8 us.
double measured_group_ns(const std::vector<std::vector<std::uint8_t>>& payloads,
                         const DecoderConfig& config);

}  // namespace zloam::driver::velodyne
