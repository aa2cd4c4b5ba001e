#pragma once
// Constants of all blocks of a sensor, by channel and laid out for four lanes at a time.

#include <array>
#include <cstdint>

#include "driver/decoder/wide.hpp"
#include "driver/velodyne/model.hpp"
#include "driver/velodyne/packet.hpp"

namespace zloam::driver::velodyne {

inline constexpr int kMostBanks = 4;
/// Channels that fire in one column; firing columns change nowhere else.
inline constexpr int kChannelsPerColumn = 16;

struct BeamTables {
  static constexpr std::size_t kChannels = std::size_t{kMostBanks} * kCellsPerBlock;
  template <typename T>
  using ByChannel = std::array<T, kChannels>;

  /// stretch: factor on the table's firing times.
  BeamTables(const ModelTable& table, double stretch, bool vertical_offsets);

  /// Rotates the beams by the motor's motion until each channel's own firing.
  void follow(double advance_cdeg);

  /// horizontal part of the beam's direction relative to its block's azimuth; follows the motor
  alignas(16) ByChannel<float> along{};
  alignas(16) ByChannel<float> across{};
  /// vertical part, and the beam's origin above the sensor's
  alignas(16) ByChannel<float> up{};
  alignas(16) ByChannel<float> height_m{};
  /// firing after the group's begin, and its ring
  alignas(16) ByChannel<std::uint32_t> time_ns{};
  alignas(16) ByChannel<std::uint32_t> ring{};
  /// firing column within the group, of sixteen channels each
  std::array<std::uint16_t, kChannels / kChannelsPerColumn> column{};

 private:
  void turn_by(double advance_rad);
#if ZLOAM_WIDE
  void turn_by_wide(double advance_rad);
#endif

  std::size_t channels_;
  double followed_cdeg_ = -1.0;
  ByChannel<double> correction_cos_{}, correction_sin_{}, elevation_cos_{}, time_share_{};
};

}  // namespace zloam::driver::velodyne
