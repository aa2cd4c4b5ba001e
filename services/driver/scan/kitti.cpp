#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "common/containers/radix_sort.hpp"
#include "driver/scan/scan.hpp"

namespace zloam::driver {
namespace {

constexpr int kHdl64Rings = 64;
constexpr double kDegPerRad = 180.0 / M_PI;
// Within a ring the azimuth ascends, except for jitter far below this.
constexpr double kBackwardDeg = 10.0;
// A ring whose first azimuth is within this of 0 may begin slightly below 0.
constexpr double kStartDeg = 20.0;

/// Tracks the azimuth along the file and detects where a ring ends. Missing returns may leave large
/// gaps in a ring, so only a step back, or passing 360 degrees, ends it.
class RingEnd {
 public:
  bool ends_before(double azimuth) {
    if (first_) {
      first_ = false;
      last_ = azimuth;
      angle_ = azimuth > 360.0 - kStartDeg ? azimuth - 360.0 : azimuth;
      return false;
    }
    const double step = azimuth - last_;
    last_ = azimuth;
    if (step < -180.0) {
      angle_ += step + 360.0;
    } else if (step > 180.0 && angle_ < kStartDeg && azimuth > 360.0 - kStartDeg) {
      angle_ += step - 360.0;
    } else if (step < -kBackwardDeg) {
      angle_ = azimuth;
      return true;
    } else {
      angle_ += step;
    }
    if (angle_ < 360.0) return false;
    angle_ -= 360.0;
    return true;
  }

 private:
  bool first_ = true;
  double last_ = 0.0;
  double angle_ = 0.0;
};

bool is_return(const float* p) {
  const bool finite = std::isfinite(p[0]) && std::isfinite(p[1]) && std::isfinite(p[2]);
  return finite && (p[0] != 0.0F || p[1] != 0.0F || p[2] != 0.0F);
}

double azimuth_deg(const float* p) {
  const double deg = std::atan2(p[1], p[0]) * kDegPerRad;
  return deg < 0.0 ? deg + 360.0 : deg;
}

/// Azimuth of each point; NaN if it is no return.
std::vector<double> azimuths_deg(std::span<const float> xyzi) {
  std::vector<double> azimuths(xyzi.size() / 4);
  for (std::size_t i = 0; i < azimuths.size(); ++i) {
    const float* p = &xyzi[4 * i];
    azimuths[i] = is_return(p) ? azimuth_deg(p) : std::numeric_limits<double>::quiet_NaN();
  }
  return azimuths;
}

std::vector<std::uint16_t> rings_from_top(const std::vector<double>& azimuths_deg,
                                          int& rings_found) {
  std::vector<std::uint16_t> ring(azimuths_deg.size(), 0);
  RingEnd end;
  int index = 0;
  for (std::size_t i = 0; i < ring.size(); ++i) {
    if (!std::isnan(azimuths_deg[i]) && end.ends_before(azimuths_deg[i])) ++index;
    ring[i] = static_cast<std::uint16_t>(std::min(index, 65535));
  }
  rings_found = ring.empty() ? 0 : index + 1;
  return ring;
}

/// Nominal elevations of an HDL-64E from the top: steps of 1/3 degree, then of 1/2 degree.
double nominal_elevation_deg(int from_top) {
  return from_top < 32 ? 2.0 - from_top / 3.0 : -8.83 - 0.5 * (from_top - 32);
}

std::vector<double> ring_elevations_deg(std::span<const float> xyzi,
                                        const std::vector<std::uint16_t>& ring, int rings) {
  std::vector<double> sum(static_cast<std::size_t>(rings), 0.0);
  std::vector<double> count(static_cast<std::size_t>(rings), 0.0);
  for (std::size_t i = 0; i < ring.size(); ++i) {
    const float* p = &xyzi[4 * i];
    if (!is_return(p)) continue;
    sum[ring[i]] += std::atan2(p[2], std::hypot(p[0], p[1])) * kDegPerRad;
    count[ring[i]] += 1.0;
  }
  for (std::size_t r = 0; r < sum.size(); ++r) sum[r] = count[r] > 0.0 ? sum[r] / count[r] : 0.0;
  return sum;
}

/// Number of rings missing above the first one found: the file omits rings without any return
/// (sky).
int rings_missing_on_top(std::span<const float> xyzi, const std::vector<std::uint16_t>& ring,
                         int rings) {
  if (rings >= kHdl64Rings) return 0;
  const std::vector<double> elevation = ring_elevations_deg(xyzi, ring, rings);
  int best = 0;
  double least = std::numeric_limits<double>::infinity();
  for (int shift = 0; shift <= kHdl64Rings - rings; ++shift) {
    double error = 0.0;
    for (int r = 0; r < rings; ++r) {
      error += std::abs(elevation[static_cast<std::size_t>(r)] - nominal_elevation_deg(r + shift));
    }
    if (error < least) {
      least = error;
      best = shift;
    }
  }
  return best;
}

std::uint32_t time_of(double azimuth, const ScanTiming& timing, double period_ns) {
  double turned = 0.0;
  if (timing.model == TimeModel::kClockwise) turned = timing.seam_deg - azimuth;
  if (timing.model == TimeModel::kCounterClockwise) turned = azimuth - timing.seam_deg;
  // The condition saves time: for half of the points it is false, and std::floor is a library call
  // without SSE4.1.
  if (turned < 0.0 || turned >= 360.0) turned -= 360.0 * std::floor(turned / 360.0);
  return static_cast<std::uint32_t>(turned / 360.0 * period_ns);
}

/// A return's time within the revolution, and its index in the file.
struct Timed {
  std::uint32_t time_ns;
  std::uint32_t index;
};

/// The returns in order of time. Sorting these small items moves a third of a point's bytes.
std::vector<Timed> in_time_order(const std::vector<double>& azimuths_deg, const ScanTiming& timing,
                                 double period_ns) {
  std::vector<Timed> timed;
  timed.reserve(azimuths_deg.size());
  for (std::size_t i = 0; i < azimuths_deg.size(); ++i) {
    if (std::isnan(azimuths_deg[i])) continue;
    timed.push_back({time_of(azimuths_deg[i], timing, period_ns), static_cast<std::uint32_t>(i)});
  }
  std::vector<Timed> spare;
  radix_sort(timed, spare, 32, [](const Timed& t) { return t.time_ns; });
  return timed;
}

void count_dropped(std::span<const float> xyzi, const std::vector<double>& azimuths_deg,
                   KittiDiagnostics& noted) {
  for (std::size_t i = 0; i < azimuths_deg.size(); ++i) {
    if (!std::isnan(azimuths_deg[i])) continue;
    const float* p = &xyzi[4 * i];
    const bool zero = p[0] == 0.0F && p[1] == 0.0F && p[2] == 0.0F;
    zero ? ++noted.dropped_zero_range : ++noted.dropped_not_finite;
  }
}

/// Fills in stamp and times relative to the first point, and columns by the time within the
/// revolution.
void fill(DecodedSweep& sweep, std::span<const float> xyzi, const std::vector<Timed>& timed,
          const std::vector<std::uint16_t>& from_top, int top_ring, double period_ns) {
  // Points to prefetch ahead: a few hundred ns, the latency of memory.
  constexpr std::size_t kAhead = 24;
  constexpr double kColumns = 2083.0;  // an HDL-64E at 10 Hz, in steps of 0.1728 degrees
  const std::uint32_t first_ns = timed.empty() ? 0 : timed.front().time_ns;
  sweep.stamp_ns += first_ns;
  sweep.points.reserve(timed.size());
  sweep.columns.reserve(timed.size());
  for (std::size_t i = 0; i < timed.size(); ++i) {
    // Points adjacent in time are of different rings, and far apart in the file.
    if (i + kAhead < timed.size()) {
      __builtin_prefetch(&xyzi[4 * std::size_t{timed[i + kAhead].index}]);
      __builtin_prefetch(&from_top[timed[i + kAhead].index]);
    }
    const auto [time_ns, index] = timed[i];
    const float* p = &xyzi[4 * std::size_t{index}];
    const int ring = std::max(top_ring - static_cast<int>(from_top[index]), 0);
    sweep.points.push_back({p[0], p[1], p[2], std::isfinite(p[3]) ? 255.0F * p[3] : 0.0F,
                            time_ns - first_ns, static_cast<std::uint16_t>(ring),
                            ReturnType::kStrongest, 0});
    sweep.columns.push_back(static_cast<std::uint16_t>(time_ns / period_ns * kColumns));
  }
}

}  // namespace

std::vector<std::uint16_t> recover_rings(std::span<const float> xyzi, int& rings_found) {
  return rings_from_top(azimuths_deg(xyzi), rings_found);
}

DecodedSweep kitti_sweep(std::span<const float> xyzi, const ScanTiming& timing,
                         std::int64_t start_ns, KittiDiagnostics* diagnostics) {
  KittiDiagnostics noted;
  const std::vector<double> azimuths = azimuths_deg(xyzi);
  const std::vector<std::uint16_t> from_top = rings_from_top(azimuths, noted.rings_found);
  const int missing = rings_missing_on_top(xyzi, from_top, noted.rings_found);
  const int rings = std::max(noted.rings_found, kHdl64Rings);
  const double period_ns = timing.period_s * 1e9;
  count_dropped(xyzi, azimuths, noted);
  DecodedSweep sweep;
  sweep.stamp_ns = start_ns;
  fill(sweep, xyzi, in_time_order(azimuths, timing, period_ns), from_top, rings - 1 - missing,
       period_ns);
  sweep.period_ns = static_cast<std::uint32_t>(std::llround(period_ns));
  sweep.rings = static_cast<std::uint16_t>(rings);
  sweep.model = "hdl64e";
  sweep.return_mode = ReturnMode::kStrongest;
  sweep.clock_source = ClockSource::kCapture;
  sweep.complete = true;
  sweep.deskewed = timing.model == TimeModel::kDeskewed;
  if (diagnostics != nullptr) *diagnostics = noted;
  return sweep;
}

}  // namespace zloam::driver
