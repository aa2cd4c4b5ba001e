#include "driver/velodyne/model_check.hpp"

#include <algorithm>
#include <cmath>

#include "driver/sweep/clock.hpp"

namespace zloam::driver::velodyne {
namespace {

// Period of a VLS-128 with firmware 5.1.7: 20 slots of 8/3 us.
constexpr double kOldGroupNs = 20.0 * 8000.0 / 3.0;

/// Median interval between neighbouring packets, which lost packets do not change.
double median_period_us(std::vector<std::uint32_t> stamps_us) {
  std::vector<std::int64_t> periods_us;
  for (std::size_t i = 1; i < stamps_us.size(); ++i) {
    periods_us.push_back(std::abs(toh_difference_us(stamps_us[i], stamps_us[i - 1])));
  }
  std::sort(periods_us.begin(), periods_us.end());
  return static_cast<double>(periods_us[periods_us.size() / 2]);
}

bool fits(Model model, ReturnMode mode, double period_us) {
  const Decoder decoder({.model = model});
  const double expected_us = 1e-3 * static_cast<double>(decoder.packet_period_ns(mode));
  return std::abs(period_us - expected_us) < 0.02 * expected_us;
}

}  // namespace

std::optional<Model> model_by_timing(const std::vector<std::vector<std::uint8_t>>& payloads,
                                     std::optional<Model> declared) {
  if (!declared || payloads.size() < kTimingPackets) return std::nullopt;
  const auto claimed = model_by_product_id(payloads.front().back());
  if (!claimed || *claimed == *declared) return std::nullopt;
  Decoder decoder({});
  std::vector<std::uint32_t> stamps_us;
  ReturnMode mode = ReturnMode::kUnknown;
  for (const auto& payload : payloads) {
    const PacketTail tail = decoder.tail(payload);
    if (tail.reject != Reject::kNone) return std::nullopt;
    stamps_us.push_back(tail.toh_us);
    mode = tail.mode;
  }
  const double period_us = median_period_us(stamps_us);
  const bool mislabelled = !fits(*claimed, mode, period_us) && fits(*declared, mode, period_us);
  return mislabelled ? declared : std::nullopt;
}

double measured_group_ns(const std::vector<std::vector<std::uint8_t>>& payloads,
                         const DecoderConfig& config) {
  if (payloads.size() < 2) return 0.0;
  Decoder decoder(config);
  std::vector<std::uint32_t> stamps_us;
  ReturnMode mode = ReturnMode::kUnknown;
  for (const auto& payload : payloads) {
    const PacketTail tail = decoder.tail(payload);
    if (tail.reject != Reject::kNone) continue;
    if (!decoder.table()->period_varies) return 0.0;
    stamps_us.push_back(tail.toh_us);
    mode = tail.mode;
  }
  if (stamps_us.size() < 2) return 0.0;
  const double middle_us = median_period_us(stamps_us);
  double sum_us = 0.0;
  int count = 0;
  for (std::size_t i = 1; i < stamps_us.size(); ++i) {
    const auto period_us = static_cast<double>(toh_difference_us(stamps_us[i], stamps_us[i - 1]));
    // Skips intervals with lost packets.
    if (std::abs(period_us - middle_us) > 0.1 * middle_us) continue;
    sum_us += period_us;
    ++count;
  }
  if (count == 0) return 0.0;
  const double groups =
      static_cast<double>(decoder.packet_period_ns(mode)) / decoder.shape().group_ns;
  const double group_ns = 1e3 * sum_us / count / groups;
  for (const double published_ns : {decoder.shape().group_ns, kOldGroupNs}) {
    if (std::abs(group_ns - published_ns) < 0.01 * published_ns) return published_ns;
  }
  return group_ns;
}

}  // namespace zloam::driver::velodyne
