#include "driver/velodyne/hdl64e.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <numbers>

#include "driver/decoder/label.hpp"
#include "driver/decoder/return_pair.hpp"
#include "driver/velodyne/model.hpp"

namespace zloam::driver::velodyne {
namespace {

constexpr std::uint32_t kMaxTohUs = 3'610'000'000U;
constexpr double kRadPerCdeg = std::numbers::pi / 18000.0;
// Distances at which the two-point correction was measured (manual).
constexpr double kFarM = 25.04;
constexpr double kNearXM = 2.40;
constexpr double kNearYM = 1.93;

const std::uint8_t* block_of(const std::uint8_t* payload, int index) {
  return payload + kBlockBytes * static_cast<std::size_t>(index);
}

std::size_t laser_of(int bank, int channel) {
  const int laser = kCellsPerBlock * bank + channel;
  return static_cast<std::size_t>(laser);
}

/// Whether the blocks are of other banks than an HDL-64E's two: all of the first, or several of
/// further ones (half of a VLS-128's). A single flag is damage.
bool of_other_model(const std::uint8_t* payload) {
  std::array<int, 4> blocks{};
  for (int k = 0; k < kBlocksPerPacket; ++k) {
    const int bank = bank_of(block_of(payload, k));
    if (bank >= 0) ++blocks[static_cast<std::size_t>(bank)];
  }
  const bool further = blocks[2] + blocks[3] > 1;
  return further || (blocks[0] > 0 && blocks[1] == 0);
}

int azimuth_of(const std::uint8_t* block) { return read_u16(block + 2); }

/// Blocks of a group: an upper and a lower one for each return.
int blocks_of(ReturnMode mode) { return 2 * static_cast<int>(returns_of(mode)); }

/// The correction of a distance along one axis, interpolated as in the manual; along_m: coordinate
/// of the point on this axis with the far correction.
double corrected(double far_m, double near_m, double nearest_m, double along_m) {
  return near_m + (far_m - near_m) * (std::abs(along_m) - nearest_m) / (kFarM - nearest_m);
}

std::vector<std::uint16_t> rings_of(const Calibration& calibration) {
  std::vector<std::uint16_t> rings;
  for (std::size_t i = 0; i < calibration.lasers.size(); ++i) {
    const double own = calibration.lasers[i].elevation_rad;
    std::uint16_t rank = 0;
    for (std::size_t other = 0; other < calibration.lasers.size(); ++other) {
      const double theirs = calibration.lasers[other].elevation_rad;
      rank = static_cast<std::uint16_t>(rank + (theirs < own || (theirs == own && other < i)));
    }
    rings.push_back(rank);
  }
  return rings;
}

}  // namespace

const Hdl64eModel* hdl64e_by_label(std::string_view label) {
  for (const Hdl64eModel& model : kHdl64eModels) {
    if (plain_label(model.label) == plain_label(label)) return &model;
  }
  return nullptr;
}

bool looks_like_hdl64e(std::span<const std::uint8_t> payload) {
  if (payload.size() != kDataPacketBytes) return false;
  for (int k = 0; k < kBlocksPerPacket; ++k) {
    if (bank_of(block_of(payload.data(), k)) != k % 2) return false;
  }
  return true;
}

Hdl64eDecoder::Hdl64eDecoder(const Hdl64eModel& model, const Calibration& calibration,
                             const DecodingOptions& options)
    : model_(model),
      options_(options),
      unit_m_(calibration.distance_unit_m),
      motor_(static_cast<double>(model.group_ns), Motor::Stamp::kLastGroup) {
  const std::vector<std::uint16_t> rings = rings_of(calibration);
  for (std::size_t i = 0; i < calibration.lasers.size(); ++i) {
    LaserCalibration laser = calibration.lasers[i];
    if (!options.vertical_offsets) laser.vertical_offset_m = 0.0;
    lasers_.push_back(
        {laser, std::cos(laser.elevation_rad), std::sin(laser.elevation_rad), rings[i]});
  }
  for (std::size_t c = 0; c < firing_ns_.size(); ++c) {
    firing_ns_[c] = static_cast<std::uint32_t>(static_cast<std::int64_t>(c / 4) * model.four_ns +
                                               model.in_four_ns[c % 4]);
  }
  shape_.model = model.label;
  shape_.rings = static_cast<std::uint16_t>(lasers_.size());
  shape_.group_ns = static_cast<double>(model.group_ns);
  shape_.groups_per_ns = 1.0 / shape_.group_ns;
  shape_.group_span_ns = firing_ns_.back();
  shape_.packet_period_ns = {kBlocksPerPacket / 2 * model.group_ns,
                             kBlocksPerPacket / 4 * model.group_ns};
  shape_.most_points_per_group = {lasers_.size(), 2 * lasers_.size()};
}

ReturnMode Hdl64eDecoder::mode_of(std::span<const std::uint8_t> payload) {
  const auto azimuth = [&](int k) { return azimuth_of(block_of(payload.data(), k)); };
  // If the motor stands still, azimuths are equal too; the mode then stays as it was.
  if (azimuth(0) != azimuth(10)) {
    const bool pairs = azimuth(0) == azimuth(2) && azimuth(4) == azimuth(6);
    last_mode_ = pairs ? ReturnMode::kDual : ReturnMode::kStrongest;
  }
  if (options_.return_mode && last_mode_ != ReturnMode::kDual &&
      *options_.return_mode != ReturnMode::kDual) {
    return *options_.return_mode;
  }
  if (options_.return_mode && *options_.return_mode != last_mode_ && !mode_noted_) {
    mode_noted_ = true;
    contradictions_.push_back(
        "driver.returns names another number of returns than the packets' azimuths show; decoded "
        "as the packets show");
  }
  return last_mode_;
}

/// Converts the stamp, which is the packet's end, to its begin, in whole microseconds.
std::uint32_t Hdl64eDecoder::begin_toh_us(std::uint32_t stamp_us, ReturnMode mode) const {
  const auto before_us = static_cast<std::uint32_t>((packet_period_ns(mode) + 999) / 1000);
  return earlier_toh_us(stamp_us, before_us);
}

PacketTail Hdl64eDecoder::tail(std::span<const std::uint8_t> payload) {
  PacketTail tail;
  if (payload.size() != kDataPacketBytes) {
    const bool begins_well = payload.size() >= 2 && bank_of(payload.data()) >= 0;
    tail.reject =
        begins_well && payload.size() < kDataPacketBytes ? Reject::kShort : Reject::kForeign;
    return tail;
  }
  if (of_other_model(payload.data())) {
    if (!model_noted_) {
      contradictions_.push_back("driver.model says " + std::string(model_.label) +
                                ", but the packets are no HDL-64E's (their product byte says " +
                                std::string(product_label(payload.back())) +
                                "): they are dropped; set driver.model to the sensor's");
    }
    model_noted_ = true;
    tail.reject = Reject::kModelMismatch;
    return tail;
  }
  const std::uint32_t stamp_us = read_u32(payload.data() + kTimeAt);
  tail.mode = mode_of(payload);
  tail.toh_us = begin_toh_us(stamp_us, tail.mode);
  tail.view_gap_ns = motor_.view_gap_ns(groups_of(payload, tail.mode));
  tail.first_azimuth_cdeg = azimuth_of(payload.data());
  if (stamp_us > kMaxTohUs) tail.reject = Reject::kBadTime;
  return tail;
}

/// The plan but for the motor's part.
PacketPlan Hdl64eDecoder::groups_of(std::span<const std::uint8_t> payload, ReturnMode mode) const {
  PacketPlan plan;
  plan.payload = payload.data();
  plan.mode = mode;
  plan.toh_us = begin_toh_us(read_u32(payload.data() + kTimeAt), mode);
  const int blocks = blocks_of(mode);
  plan.groups = kBlocksPerPacket / blocks;
  plan.duration_ns = packet_period_ns(mode);
  const std::int64_t rest_ns = (1000 - plan.duration_ns % 1000) % 1000;
  for (int g = 0; g < plan.groups; ++g) {
    Group& group = plan.group[static_cast<std::size_t>(g)];
    group.offset_ns = rest_ns + g * model_.group_ns;
    for (int b = 0; b < blocks; ++b) {
      const std::uint8_t* const block = block_of(plan.payload, g * blocks + b);
      const int bank = bank_of(block);
      if ((bank != 0 && bank != 1) || azimuth_of(block) > kTurnCdeg) {
        ++plan.bad_blocks;
      } else if (!group.valid) {
        group.valid = true;
        group.azimuth_cdeg = azimuth_of(block) % kTurnCdeg;
      }
    }
  }
  return plan;
}

PacketPlan Hdl64eDecoder::plan(std::span<const std::uint8_t> payload, ReturnMode mode) {
  PacketPlan plan = groups_of(payload, mode);
  motor_.measure(plan);
  plan.next_ns = plan.duration_ns;
  return plan;
}

void Hdl64eDecoder::intensity_of(const Laser& laser, const std::uint8_t* cell, Point& point) const {
  // Manual, "Intensity Compensation"; distances are relative to the greatest one, 131 m or 65535
  // units.
  const double focal = 1.0 - laser.calibration.focal_distance_m / 131.0;
  const double own = 1.0 - read_u16(cell) / 65535.0;
  const double added = 256.0 * laser.calibration.focal_slope * std::abs(focal * focal - own * own);
  point.intensity =
      static_cast<float>(std::max(laser.calibration.least_intensity,
                                  std::min(cell[2] + added, laser.calibration.greatest_intensity)));
}

// Two-point correction (manual, appendix "Coordinate Calculation"): the correction of the distance
// is interpolated between near and far, for x and y separately; offsets are applied last. The
// manual's y is our x, its x our -y.
Hdl64eDecoder::Cell Hdl64eDecoder::cell_of(const std::uint8_t* block, int channel,
                                           double azimuth_rad, std::uint32_t time_ns) const {
  Cell cell{};
  const int bank = bank_of(block);
  if ((bank != 0 && bank != 1) || azimuth_of(block) > kTurnCdeg) return cell;
  const Laser& laser = lasers_[laser_of(bank, channel)];
  const std::uint8_t* const at = block + 4 + std::ptrdiff_t{3} * channel;
  const LaserCalibration& own = laser.calibration;
  cell.raw = read_u16(at);
  const double measured_m = cell.raw * unit_m_;
  const double far_m = measured_m + own.far_m;
  cell.is_return = cell.raw != 0 && own.enabled && far_m >= options_.min_range_m &&
                   far_m <= options_.max_range_m;
  const double a = azimuth_rad - own.azimuth_correction_rad;
  const double sin_a = std::sin(a);
  const double cos_a = std::cos(a);
  double along_x_m = own.far_m;
  double along_y_m = own.far_m;
  if (measured_m < kFarM) {
    along_x_m = corrected(own.far_m, own.near_x_m, kNearXM, far_m * laser.cos_elevation * sin_a);
    along_y_m = corrected(own.far_m, own.near_y_m, kNearYM, far_m * laser.cos_elevation * cos_a);
  }
  const double manual_x =
      (measured_m + along_x_m) * laser.cos_elevation * sin_a - own.horizontal_offset_m * cos_a;
  const double manual_y =
      (measured_m + along_y_m) * laser.cos_elevation * cos_a + own.horizontal_offset_m * sin_a;
  cell.point.x = static_cast<float>(manual_y);
  cell.point.y = static_cast<float>(-manual_x);
  cell.point.z =
      static_cast<float>((measured_m + along_y_m) * laser.sin_elevation + own.vertical_offset_m);
  cell.point.time_ns = time_ns;
  cell.point.ring = laser.ring;
  intensity_of(laser, at, cell.point);
  return cell;
}

std::size_t Hdl64eDecoder::decode_groups(const PacketPlan& plan,
                                         std::span<const PlacedGroup> groups, Point* out,
                                         std::uint16_t* columns) const {
  std::size_t count = 0;
  const auto put = [&](Cell cell, ReturnType type, bool kept, std::uint16_t column) {
    cell.point.return_type = type;
    out[count] = cell.point;
    columns[count] = column;
    count += kept;
  };
  const bool dual = plan.mode == ReturnMode::kDual;
  const ReturnType single = single_type(plan.mode);
  const double turn_rad_per_ns =
      kRadPerCdeg * plan.advance_cdeg / static_cast<double>(model_.group_ns);
  for (const PlacedGroup& placed : groups) {
    const std::uint8_t* const first = block_of(plan.payload, placed.group * blocks_of(plan.mode));
    const double group_rad =
        kRadPerCdeg * plan.group[static_cast<std::size_t>(placed.group)].azimuth_cdeg;
    // An upper and a lower laser fire at the same time.
    for (int c = 0; c < kCellsPerBlock; ++c) {
      const std::uint32_t firing_ns = firing_ns_[static_cast<std::size_t>(c)];
      const double azimuth_rad = group_rad + turn_rad_per_ns * firing_ns;
      const std::uint32_t time_ns = placed.time_ns + firing_ns;
      for (int half = 0; half < 2; ++half) {
        const Cell strongest = cell_of(block_of(first, half), c, azimuth_rad, time_ns);
        if (!dual) {
          put(strongest, single, strongest.is_return, placed.column);
          continue;
        }
        const Cell last = cell_of(block_of(first, 2 + half), c, azimuth_rad, time_ns);
        const PairChoice choice = choose(last.is_return, strongest.is_return,
                                         last.raw == strongest.raw, options_.dual_returns);
        put(last, choice.last_type, choice.last, placed.column);
        put(strongest, choice.strongest_type, choice.strongest, placed.column);
      }
    }
  }
  return count;
}

}  // namespace zloam::driver::velodyne
