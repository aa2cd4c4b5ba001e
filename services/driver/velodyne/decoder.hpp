#pragma once
// Data packets of the Velodyne family to points. Coordinates: x forward (azimuth 0), y left, z up;
// azimuth grows clockwise.

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "common/geometry/point.hpp"
#include "driver/velodyne/beams.hpp"
#include "driver/velodyne/block_points.hpp"
#include "driver/velodyne/model.hpp"
#include "driver/velodyne/motor.hpp"
#include "driver/velodyne/packet.hpp"

namespace zloam::driver {

struct DecoderConfig {
  /// nothing: by the packets' product byte
  std::optional<Model> model = std::nullopt;
  /// nothing: by the packets' mode byte
  std::optional<ReturnMode> return_mode = std::nullopt;
  /// which returns of a pair are given
  DualReturns dual_returns = DualReturns::kTagged;
  /// nearer and farther returns are none; both ends belong to it. Of the measured distance.
  double min_range_m = 0.0;
  double max_range_m = 1000.0;
  /// from one firing group to the next; 0: the model's own
  double group_ns = 0.0;
  /// the lasers do not leave from one point; most data sets leave the shift (up to 17 mm) out
  bool vertical_offsets = true;
};

/// A group of a packet, and where it lies in its sweep.
struct PlacedGroup {
  int group;
  /// of its first firing; a point's time is that and the firing's place in the group
  std::uint32_t time_ns;
  /// of its first firings
  std::uint16_t column;
};

/// Decodes packets of one sensor. Keeps the model once known and the last plausible motor speed.
class Decoder {
 public:
  explicit Decoder(const DecoderConfig& config);

  PacketTail tail(std::span<const std::uint8_t> payload);

  /// The packet's groups, azimuths and times; payload must have passed tail() and outlive the plan.
  PacketPlan plan(std::span<const std::uint8_t> payload, ReturnMode mode);

  /// Writes the returns of valid groups of the packet planned last, in time order. out and columns
  /// need room for max_points_per_group(mode) of each group, and 1. Returns the number of points.
  std::size_t decode_groups(const PacketPlan& plan, std::span<const PlacedGroup> groups, Point* out,
                            std::uint16_t* columns) const;

  /// Nothing before the first packet when the model is not forced.
  const ModelTable* table() const { return table_; }
  /// From one firing group to the next.
  double group_ns() const { return group_ns_; }
  double groups_per_ns() const { return groups_per_ns_; }
  std::size_t max_points_per_group(ReturnMode mode) const {
    const std::size_t returns = mode == ReturnMode::kDual ? 2 : 1;
    return returns * static_cast<std::size_t>(banks_) * std::size_t{kCellsPerBlock};
  }

  /// From one packet's stamp to the next in this mode, without loss.
  std::int64_t packet_period_ns(ReturnMode mode) const {
    if (!stream_) return 0;
    return mode == ReturnMode::kDual ? stream_->dual_period_ns : stream_->single_period_ns;
  }

  /// A sentence for each contradiction between configuration and packets; empty when there is none.
  const std::vector<std::string>& contradictions() const { return contradictions_; }

 private:
  /// What follows from the model alone.
  struct Stream {
    BeamTables beams;
    Motor motor;
    RawLimits limits;
    std::array<std::int64_t, kBlocksPerPacket> group_offset_ns;
    std::int64_t single_period_ns;
    std::int64_t dual_period_ns;
  };

  void use_model(Model model);
  RawLimits limits() const;
  std::int64_t period_of(int returns) const;
  Reject check_model(std::uint8_t product_id);
  ReturnMode check_mode(std::uint8_t mode_byte);
  void note_contradiction(bool& noted, std::string text);
  void read_blocks(PacketPlan& plan) const;
  void put_group(const PacketPlan& plan, const PlacedGroup& placed, PointSink& sink) const;

  DecoderConfig config_;
  const ModelTable* table_ = nullptr;
  std::optional<Stream> stream_;
  int banks_ = 1;
  double group_ns_ = 0.0;
  double groups_per_ns_ = 0.0;
  float unit_m_ = 0.0F;
  bool model_noted_ = false;
  bool mode_noted_ = false;
  std::vector<std::string> contradictions_;
};

}  // namespace zloam::driver
