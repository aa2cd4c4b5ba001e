#pragma once
// Constants of the preview. None is a key of the robot's file: the purpose of a preview is its low
// rate, and the sizes follow from it.

#include <cstddef>
#include <cstdint>

namespace zloam::preview {

/// Half of the 800 kbit/s that a mobile network gives in its worse hours.
inline constexpr std::size_t kMost_bytes_per_s = 50'000;
/// Four messages a second show motion. Two messages are at least a fifth of a second apart, so any
/// second holds at most five, and each may use a fifth of its bytes.
inline constexpr std::int64_t kPeriod_ms = 250;
inline constexpr std::int64_t kLeastPeriod_ns = 200'000'000;
inline constexpr std::size_t kMost_messages_per_s = 5;
inline constexpr std::size_t kMessage_bytes = kMost_bytes_per_s / kMost_messages_per_s;

/// A block that has not changed is sent again after ten seconds at the earliest, so that a small
/// map at rest uses only a part of the rate.
inline constexpr std::uint64_t kRestCalls = 10'000 / kPeriod_ms;

/// Smallest cell edge, used near the robot; beyond this distance the edge doubles with it.
inline constexpr double kFinest_m = 0.19;
inline constexpr double kFineWithin_m = 25.0;
/// The farthest cells are larger by this many doublings: 0.2 m to 1.6 m.
inline constexpr int kDoublings = 3;
/// A cube's edge has 2^2 blocks: a block of a 50 m cube has 12.5 m and fits into a message.
inline constexpr int kSplit = 2;
/// A map of hundreds of kilometres of streets has fewer. Cubes come from messages: a higher number
/// must be an error.
inline constexpr std::size_t kMostBlocks = 200'000;

}  // namespace zloam::preview
