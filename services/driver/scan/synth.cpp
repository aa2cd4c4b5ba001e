#include <algorithm>
#include <cmath>
#include <cstring>

#include "driver/scan/scan.hpp"

namespace zloam::driver {
namespace {

constexpr std::size_t kRecordBytes = 16;
constexpr std::uint32_t kTickNs = 2000;
constexpr std::uint32_t kFiringNs = 55296;

struct Record {
  float x, y, z;
  std::uint8_t intensity;
  std::uint8_t ring;
  std::uint16_t ticks;
};
static_assert(sizeof(Record) == kRecordBytes);

}  // namespace

std::optional<DecodedSweep> synth_sweep(std::span<const std::byte> records, std::int64_t start_ns,
                                        std::int64_t end_ns) {
  if (records.size() % kRecordBytes != 0) return std::nullopt;
  DecodedSweep sweep;
  sweep.rings = 16;
  for (std::size_t at = 0; at < records.size(); at += kRecordBytes) {
    Record record;
    std::memcpy(&record, records.data() + at, kRecordBytes);
    const bool finite =
        std::isfinite(record.x) && std::isfinite(record.y) && std::isfinite(record.z);
    if (!finite) continue;
    const std::uint32_t time_ns = kTickNs * record.ticks;
    sweep.points.push_back({record.x, record.y, record.z, static_cast<float>(record.intensity),
                            time_ns, record.ring, ReturnType::kStrongest, 0});
    sweep.rings = std::max<std::uint16_t>(sweep.rings, static_cast<std::uint16_t>(record.ring + 1));
  }
  std::stable_sort(sweep.points.begin(), sweep.points.end(),
                   [](const Point& a, const Point& b) { return a.time_ns < b.time_ns; });
  const std::uint32_t first_ns = sweep.points.empty() ? 0 : sweep.points.front().time_ns;
  for (Point& p : sweep.points) {
    // A record's time is rounded to 2 us, so half of this is added; the 16 lasers of a firing fire
    // within 34.6 us of its begin.
    sweep.columns.push_back(static_cast<std::uint16_t>((p.time_ns + kTickNs / 2) / kFiringNs));
    p.time_ns -= first_ns;
  }
  sweep.stamp_ns = start_ns + first_ns;
  sweep.period_ns =
      static_cast<std::uint32_t>(std::clamp<std::int64_t>(end_ns - start_ns, 0, 4'000'000'000));
  sweep.model = "vlp16";
  sweep.return_mode = ReturnMode::kStrongest;
  sweep.clock_source = ClockSource::kSynthetic;
  sweep.complete = true;
  return sweep;
}

}  // namespace zloam::driver
