#pragma once
// Scans stored as files of points, to sweeps: KITTI's layout, which has neither rings nor times,
// and a 16-byte layout that has both.

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "driver/sweep/decoded_sweep.hpp"

namespace zloam::driver {

/// How times are computed for points that have none.
enum class TimeModel : std::uint8_t {
  kNone,              // refused: the user must choose one
  kClockwise,         // by azimuth, the sensor turns clockwise seen from above
  kCounterClockwise,  // by azimuth, in the other direction
  kDeskewed           // all points hold for one instant already
};

/// Names used by the configuration and the reader of recordings.
inline const std::vector<std::pair<std::string, TimeModel>> kTimeModels = {
    {"none", TimeModel::kNone},
    {"clockwise", TimeModel::kClockwise},
    {"counter_clockwise", TimeModel::kCounterClockwise},
    {"deskewed", TimeModel::kDeskewed}};

struct ScanTiming {
  TimeModel model = TimeModel::kNone;
  /// one revolution
  double period_s = 0.1;
  /// where the revolution begins, degrees counter-clockwise from the front; 180: the rear
  double seam_deg = 180.0;
};

struct KittiDiagnostics {
  int rings_found = 0;
  std::size_t dropped_zero_range = 0;
  std::size_t dropped_not_finite = 0;
};

/// Rings of points stored ring by ring, top ring first, each from azimuth 0 counter-clockwise:
/// a ring ends where the azimuth comes back to the start. One index for each point, 0 for the first
/// (highest) ring found. xyzi: 4 floats a point; rings_found receives the number of rings.
std::vector<std::uint16_t> recover_rings(std::span<const float> xyzi, int& rings_found);

/// A scan of 4 floats (x, y, z, reflectance 0..1) a point. start_ns: begin of the revolution. The
/// sweep is in time order, rings by ascending elevation of an HDL-64E, intensity 0..255.
DecodedSweep kitti_sweep(std::span<const float> xyzi, const ScanTiming& timing,
                         std::int64_t start_ns, KittiDiagnostics* diagnostics = nullptr);

/// A scan of 16-byte records: float x, y, z; uint8 intensity, ring; uint16 time in 2 us after
/// start_ns; in time order. Nothing when the size is no multiple of 16.
std::optional<DecodedSweep> synth_sweep(std::span<const std::byte> records, std::int64_t start_ns,
                                        std::int64_t end_ns);

}  // namespace zloam::driver
