#include "driver/velodyne/beams.hpp"

#include <cmath>
#include <numbers>

namespace zloam::driver::velodyne {
namespace {

constexpr double kRadPerCdeg = std::numbers::pi / 18000.0;

}  // namespace

BeamTables::BeamTables(const ModelTable& table, double stretch, bool vertical_offsets)
    : channels_(table.channels.size()) {
  for (std::size_t c = 0; c < channels_; ++c) {
    const Channel& channel = table.channels[c];
    const double elevation_rad = channel.elevation_deg * std::numbers::pi / 180.0;
    const double correction_rad = channel.azimuth_correction_deg * std::numbers::pi / 180.0;
    correction_cos_[c] = std::cos(correction_rad);
    correction_sin_[c] = std::sin(correction_rad);
    elevation_cos_[c] = std::cos(elevation_rad);
    time_share_[c] = channel.time_ns / table.group_ns;
    up[c] = static_cast<float>(std::sin(elevation_rad));
    height_m[c] = vertical_offsets ? static_cast<float>(channel.vertical_offset_m) : 0.0F;
    time_ns[c] = static_cast<std::uint32_t>(std::lround(stretch * channel.time_ns));
    ring[c] = channel.ring;
    column[c / kChannelsPerColumn] = channel.column;
  }
}

// Inlined into both callers, so that it is compiled for each one's instruction set; the operations
// are the same.
__attribute__((always_inline)) inline void BeamTables::turn_by(double advance_rad) {
  for (std::size_t c = 0; c < channels_; ++c) {
    // At most 1 degree, where the series are exact to 1e-12.
    const double a = advance_rad * time_share_[c];
    const double cos_a = 1.0 - a * a * (0.5 - a * a / 24.0);
    const double sin_a = a * (1.0 - a * a * (1.0 / 6.0 - a * a / 120.0));
    along[c] = static_cast<float>(elevation_cos_[c] *
                                  (cos_a * correction_cos_[c] + sin_a * correction_sin_[c]));
    across[c] = static_cast<float>(elevation_cos_[c] *
                                   (sin_a * correction_cos_[c] - cos_a * correction_sin_[c]));
  }
}

#if ZLOAM_WIDE
__attribute__((target("avx2"))) void BeamTables::turn_by_wide(double advance_rad) {
  turn_by(advance_rad);
}
#endif

void BeamTables::follow(double advance_cdeg) {
  if (advance_cdeg == followed_cdeg_) return;
  followed_cdeg_ = advance_cdeg;
#if ZLOAM_WIDE
  if (has_avx2()) {
    turn_by_wide(advance_cdeg * kRadPerCdeg);
    return;
  }
#endif
  turn_by(advance_cdeg * kRadPerCdeg);
}

}  // namespace zloam::driver::velodyne
