#pragma once
// cos and sin of whole hundredths of a degree, from one table for degrees, one for the rest, and
// the addition theorem. Small enough for the first-level cache.

#include <array>
#include <cmath>
#include <numbers>
#include <utility>

namespace zloam::driver {

class AzimuthTable {
 public:
  AzimuthTable() {
    for (int i = 0; i < 360; ++i) degrees_[i] = direction(100 * i);
    for (int i = 0; i < 100; ++i) rest_[i] = direction(i);
  }
  /// 0 to 35999.
  std::pair<double, double> cos_sin(int cdeg) const {
    // Unsigned: a third of the instructions where the compiler divides several at once.
    const auto azimuth_cdeg = static_cast<unsigned>(cdeg);
    const auto& [c, s] = degrees_[azimuth_cdeg / 100];
    const auto& [rc, rs] = rest_[azimuth_cdeg % 100];
    return {c * rc - s * rs, s * rc + c * rs};
  }

 private:
  static std::pair<double, double> direction(int cdeg) {
    const double azimuth_rad = cdeg * std::numbers::pi / 18000.0;
    return {std::cos(azimuth_rad), std::sin(azimuth_rad)};
  }
  std::array<std::pair<double, double>, 360> degrees_;
  std::array<std::pair<double, double>, 100> rest_;
};

inline const AzimuthTable& azimuth_table() {
  static const AzimuthTable kTable;
  return kTable;
}

}  // namespace zloam::driver
