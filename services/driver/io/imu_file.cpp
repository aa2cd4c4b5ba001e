#include "driver/io/imu_file.hpp"

#include <algorithm>
#include <string_view>

#include "driver/io/packet_source.hpp"
#include "driver/io/stamped_table.hpp"

namespace zloam::driver {
namespace {

const std::vector<std::string_view> kColumns = {"t_ns",    "wx_rad_s", "wy_rad_s", "wz_rad_s",
                                                "ax_m_s2", "ay_m_s2",  "az_m_s2"};
// Bounds of an inertial sensor's rate; outside of them the stamps are in another unit.
constexpr double kMostReadings_hz = 20'000.0;
constexpr double kFewestReadings_hz = 0.5;
// Smaller steps back are readings out of order; the buffer drops all readings before a larger one.
constexpr std::int64_t kSetBack_ns = 1'000'000'000;

/// The median step reveals a wrong unit of the stamps, and a file in descending order.
void refuse_wrong_stamps(const std::string& path, const std::vector<ImuReading>& readings) {
  std::vector<std::int64_t> steps_ns;
  for (std::size_t i = 1; i < readings.size(); ++i) {
    const std::int64_t step_ns = readings[i].stamp_ns - readings[i - 1].stamp_ns;
    if (step_ns != 0) steps_ns.push_back(step_ns);
  }
  if (steps_ns.empty()) return;
  const auto middle = steps_ns.begin() + static_cast<std::ptrdiff_t>(steps_ns.size() / 2);
  std::nth_element(steps_ns.begin(), middle, steps_ns.end());
  if (*middle < 0) throw SourceError(path + ": the stamps descend: sort the lines by t_ns");
  const double rate_hz = 1e9 / static_cast<double>(*middle);
  if (rate_hz <= kMostReadings_hz && rate_hz >= kFewestReadings_hz) return;
  std::string unit;
  for (const auto& [factor, name] : {std::pair{1e3, "us"}, {1e6, "ms"}, {1e9, "s"}}) {
    const bool fits = rate_hz / factor <= kMostReadings_hz && rate_hz / factor >= 1.0;
    if (fits && unit.empty()) unit = std::string(", as if they were ") + name;
  }
  throw SourceError(path + ": its stamps are " + std::to_string(*middle) +
                    " apart: t_ns is in nanoseconds" + unit);
}

/// Before and after a clock was set, or in two recordings one after the other, stamps are of
/// different clocks: only one part can fit the sweeps.
void refuse_set_back(const std::string& path, const std::vector<ImuReading>& readings) {
  std::int64_t latest_ns = readings.front().stamp_ns;
  for (const ImuReading& r : readings) {
    if (r.stamp_ns <= latest_ns - kSetBack_ns) {
      throw SourceError(path + ": its stamps go back from " + std::to_string(latest_ns) + " to " +
                        std::to_string(r.stamp_ns) +
                        " ns: sort the lines by t_ns, or leave out those of another clock");
    }
    latest_ns = std::max(latest_ns, r.stamp_ns);
  }
}

}  // namespace

std::vector<ImuReading> read_imu_file(const std::string& path) {
  std::vector<ImuReading> readings;
  for (const StampedRow& row : read_stamped_table(path, kColumns)) {
    const std::vector<double>& v = row.values;
    readings.push_back({.stamp_ns = row.stamp_ns,
                        .force_mps2 = {v[3], v[4], v[5]},
                        .rate_radps = {v[0], v[1], v[2]}});
  }
  if (readings.empty()) throw SourceError(path + ": holds no reading");
  refuse_wrong_stamps(path, readings);
  refuse_set_back(path, readings);
  return readings;
}

std::string standstill_in(const std::vector<ImuReading>& readings) {
  // A real sensor's noise changes every reading. A simulated sensor without noise repeats its
  // readings while the platform is at rest, but does so from the start of the file, which is not
  // reported.
  constexpr std::size_t kSame = 50;
  std::size_t same = 0;
  for (std::size_t i = 1; i < readings.size(); ++i) {
    const bool equal = readings[i].rate_radps == readings[i - 1].rate_radps &&
                       readings[i].force_mps2 == readings[i - 1].force_mps2 &&
                       readings[i].stamp_ns != readings[i - 1].stamp_ns;
    same = equal ? same + 1 : 0;
    if (same == kSame && i > kSame) {
      return "the readings are the same for " + std::to_string(kSame) + " times in a row from " +
             std::to_string(readings[i - kSame].stamp_ns) + " ns on: did the sensor hang?";
    }
  }
  return {};
}

}  // namespace zloam::driver
