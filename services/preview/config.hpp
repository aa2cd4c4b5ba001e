#pragma once
// Numbers of the preview. None is a key of the robot's file: the rate is what a preview is for, and
// the sizes follow from it.

#include <cstddef>
#include <cstdint>

namespace zloam::preview {

/// Of a link over a mobile network half of what its worse hours give, 800 kbit/s.
inline constexpr std::size_t kMost_bytes_per_s = 50'000;
/// Four messages a second show motion; no two come closer than a fifth of a second, so that of any
/// second five count, and each may have a fifth of its bytes.
inline constexpr std::int64_t kPeriod_ms = 250;
inline constexpr std::int64_t kLeastPeriod_ns = 200'000'000;
inline constexpr std::size_t kMost_messages_per_s = 5;
inline constexpr std::size_t kMessage_bytes = kMost_bytes_per_s / kMost_messages_per_s;

/// What has not changed rests for ten seconds before it is sent again: a small map at rest takes a
/// part of the rate only.
inline constexpr std::uint64_t kRestCalls = 10'000 / kPeriod_ms;

/// Cells near the robot are no smaller; at this distance they begin to double with it.
inline constexpr double kFinest_m = 0.19;
inline constexpr double kFineWithin_m = 25.0;
/// The farthest are so many doublings larger: 0.2 m to 1.6 m.
inline constexpr int kDoublings = 3;
/// Blocks along a cube's edge are 2^2: of a cube of 50 m each has 12.5 m, and fits a message.
inline constexpr int kSplit = 2;
/// A map of hundreds of kilometres of streets has fewer. Cubes are what messages say: more are a
/// stranger's.
inline constexpr std::size_t kMostBlocks = 200'000;

}  // namespace zloam::preview
