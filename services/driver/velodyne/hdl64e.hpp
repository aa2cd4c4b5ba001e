#pragma once
// Data packets of an HDL-64E (S2, S3) to points, by the unit's calibration.
//
// Blocks alternate between the upper and the lower 32 lasers, and two or, with two returns, four of
// them are one firing group. The packets contain neither model nor mode (their last two bytes hold
// the sensor's state): the user names the model; equal azimuths show two returns.
//
// Where the sources disagree (manual of an early S2, two public decoders): the stamp is taken as
// the end of the packet, when it is sent; driver.stamp_offset_us moves it if a unit stamps the
// first firing (288 for S2, 345.6 for S3, with two returns 144 and 172.8). Firing times are those
// of both decoders.

#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "driver/decoder/maker.hpp"
#include "driver/decoder/motor.hpp"
#include "driver/velodyne/calibration.hpp"
#include "driver/velodyne/packet.hpp"

namespace zloam::driver::velodyne {

/// Differences between the editions.
struct Hdl64eModel {
  std::string_view label;
  std::int64_t group_ns;
  /// from one group of four of a block's lasers to the next, and within a group
  std::int64_t four_ns;
  std::array<std::int64_t, 4> in_four_ns;
};

inline constexpr std::array kHdl64eModels = {
    Hdl64eModel{"HDL-64E S2", 48'000, 6'000, {0, 1'260, 2'460, 3'660}},
    Hdl64eModel{"HDL-64E S3", 57'600, 7'200, {0, 1'300, 2'500, 3'700}},
};

/// By its label, ignoring case, spaces and punctuation; nullptr: none of them.
const Hdl64eModel* hdl64e_by_label(std::string_view label);

/// Whether the blocks of a packet alternate as those of an HDL-64E do.
bool looks_like_hdl64e(std::span<const std::uint8_t> payload);

class Hdl64eDecoder final : public PacketDecoder {
 public:
  Hdl64eDecoder(const Hdl64eModel& model, const Calibration& calibration,
                const DecodingOptions& options);

  PacketTail tail(std::span<const std::uint8_t> payload) override;
  PacketPlan plan(std::span<const std::uint8_t> payload, ReturnMode mode) override;
  std::size_t decode_groups(const PacketPlan& plan, std::span<const PlacedGroup> groups, Point* out,
                            std::uint16_t* columns) const override;

 private:
  /// Constants of a laser.
  struct Laser {
    LaserCalibration calibration;
    double cos_elevation, sin_elevation;
    std::uint16_t ring;
  };
  /// A point, and whether it is a return.
  struct Cell {
    std::uint32_t raw;
    bool is_return;
    Point point;
  };

  ReturnMode mode_of(std::span<const std::uint8_t> payload);
  std::uint32_t begin_toh_us(std::uint32_t stamp_us, ReturnMode mode) const;
  PacketPlan groups_of(std::span<const std::uint8_t> payload, ReturnMode mode) const;
  Cell cell_of(const std::uint8_t* block, int channel, double azimuth_rad,
               std::uint32_t time_ns) const;
  void intensity_of(const Laser& laser, const std::uint8_t* cell, Point& point) const;

  Hdl64eModel model_;
  DecodingOptions options_;
  double unit_m_;
  std::vector<Laser> lasers_;
  std::array<std::uint32_t, kCellsPerBlock> firing_ns_{};
  Motor motor_;
  ReturnMode last_mode_ = ReturnMode::kStrongest;
  bool mode_noted_ = false;
  bool model_noted_ = false;
};

}  // namespace zloam::driver::velodyne
