#pragma once
// Data packets of the Velodyne family to points.

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>

#include "common/geometry/point.hpp"
#include "driver/decoder/motor.hpp"
#include "driver/decoder/packet_decoder.hpp"
#include "driver/velodyne/beams.hpp"
#include "driver/velodyne/block_points.hpp"
#include "driver/velodyne/model.hpp"
#include "driver/velodyne/packet.hpp"

namespace zloam::driver::velodyne {

struct DecoderConfig {
  /// nothing: by the packets' product byte
  std::optional<Model> model = std::nullopt;
  /// nothing: by the packets' mode byte
  std::optional<ReturnMode> return_mode = std::nullopt;
  /// which returns of a pair are kept
  DualReturns dual_returns = DualReturns::kTagged;
  /// nearer and farther returns are dropped; both ends are kept. Of the measured distance.
  double min_range_m = 0.0;
  double max_range_m = 1000.0;
  /// from one firing group to the next; 0: the model's own
  double group_ns = 0.0;
  /// the lasers have different origins; most data sets ignore the shift (up to 17 mm)
  bool vertical_offsets = true;
  /// false: the user chose the model in contradiction to the packets
  bool says_contradictions = true;
};

/// Decodes packets of one sensor. Keeps the model once known and the last plausible motor speed.
class Decoder final : public PacketDecoder {
 public:
  explicit Decoder(const DecoderConfig& config);

  PacketTail tail(std::span<const std::uint8_t> payload) override;
  PacketPlan plan(std::span<const std::uint8_t> payload, ReturnMode mode) override;
  std::size_t decode_groups(const PacketPlan& plan, std::span<const PlacedGroup> groups, Point* out,
                            std::uint16_t* columns) const override;

  /// Nothing before the first packet when the model is not forced.
  const ModelTable* table() const { return table_; }

 private:
  /// Constants of the model.
  struct Stream {
    BeamTables beams;
    Motor motor;
    RawLimits limits;
    std::array<std::int64_t, kBlocksPerPacket> group_offset_ns;
  };

  void use_model(Model model);
  std::int64_t period_of(int returns) const;
  void shape_stream();
  Reject check_model(std::uint8_t product_id);
  ReturnMode check_mode(std::uint8_t mode_byte);
  void note_contradiction(bool& noted, std::string text);
  void read_blocks(PacketPlan& plan) const;
  void put_group(const PacketPlan& plan, const PlacedGroup& placed, PointSink& sink) const;

  DecoderConfig config_;
  const ModelTable* table_ = nullptr;
  std::optional<Stream> stream_;
  int banks_ = 1;
  float unit_m_ = 0.0F;
  bool model_noted_ = false;
  bool mode_noted_ = false;
};

}  // namespace zloam::driver::velodyne
