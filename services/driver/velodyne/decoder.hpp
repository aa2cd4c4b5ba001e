#pragma once
// Data packets of the Velodyne family to points: 1206 bytes of UDP payload, 12 blocks of 32 cells,
// a time stamp in microseconds since the top of the hour, return mode and product byte (VLP-16
// manual 63-9243, section 9.3). Coordinates: x forward (azimuth 0), y left, z up; azimuth grows
// clockwise.

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "common/geometry/point.hpp"
#include "driver/velodyne/model.hpp"

namespace zloam::driver {

inline constexpr std::size_t kDataPacketBytes = 1206;
inline constexpr std::size_t kPositionPacketBytes = 512;
inline constexpr int kBlocksPerPacket = 12;
inline constexpr int kTurnCdeg = 36000;
/// Cells of a packet, and so the most points it can give.
inline constexpr std::size_t kMaxPointsPerPacket = 384;

enum class ReturnMode : std::uint8_t { kUnknown = 0, kStrongest = 1, kLast = 2, kDual = 3 };

/// What becomes of the two returns of one firing. The odd block of a pair is taken for the
/// strongest; where that is the last one itself, it holds the second strongest, and nothing in the
/// packet tells the two cases apart (VLP-16 manual p. 57).
enum class DualReturns : std::uint8_t {
  kStrongest,  // one: the odd block's, or the even one's where that is empty
  kLast,       // one: the even block's, or the odd one's where that is empty
  kBoth,       // both, of equal type for the stages that follow (kBoth); equal distances once
  kTagged      // both, with their types; equal distances once, as kBoth
};

/// Why a packet, or a block of it, gave no points.
enum class Reject : std::uint8_t {
  kNone,
  kShort,          // a data packet cut off
  kForeign,        // a length that is no packet of this family
  kUnknownModel,   // product byte of no model known here, and none forced
  kModelMismatch,  // product byte of another model than the stream began with
  kUnknownMode,    // return mode byte that is none of 0x37, 0x38, 0x39
  kBadTime,        // time stamp beyond the hour and its tolerance
};

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

/// What a look at the tail of a packet tells; cheap, for ordering packets before they are decoded.
struct PacketTail {
  Reject reject = Reject::kNone;
  std::uint32_t toh_us = 0;
  ReturnMode mode = ReturnMode::kUnknown;
};

/// One firing group: a block, a pair of blocks (dual return), or the banks of a 128-beam model.
struct Group {
  bool valid = false;
  int azimuth_cdeg = 0;
  /// firing of the group's first channel after the packet's stamp
  std::int64_t offset_ns = 0;
};

/// A packet made ready for decoding.
struct PacketPlan {
  const std::uint8_t* payload = nullptr;
  std::uint32_t toh_us = 0;
  ReturnMode mode = ReturnMode::kUnknown;
  int groups = 0;
  std::array<Group, kBlocksPerPacket> group;
  /// azimuth advance in one group, 0.01 degrees; 0 when unknown
  double advance_cdeg = 0.0;
  /// from this packet's stamp to the next one's
  std::int64_t duration_ns = 0;
  int bad_blocks = 0;
  /// first group after a restricted field of view's gap, or 0; the gap's time is in the offsets
  int gap_before_group = 0;
};

/// Decodes packets of one sensor. Keeps the model once known and the last plausible motor speed.
class Decoder {
 public:
  explicit Decoder(const DecoderConfig& config);

  PacketTail tail(std::span<const std::uint8_t> payload);

  /// The packet's groups, azimuths and times; payload must have passed tail() and outlive the plan.
  PacketPlan plan(std::span<const std::uint8_t> payload, ReturnMode mode);

  /// Writes the returns of one group of the packet planned last, in time order. out and columns
  /// need room for max_points_per_group() + 1. Point times are time_ns plus the firing's place in
  /// the group. Returns the number of points.
  std::size_t decode_group(const PacketPlan& plan, int group, std::uint32_t time_ns,
                           std::uint16_t column, Point* out, std::uint16_t* columns) const;

  /// Nothing before the first packet when the model is not forced.
  const ModelTable* table() const { return table_; }
  /// From one firing group to the next.
  double group_ns() const { return group_ns_; }
  std::size_t max_points_per_group() const { return 64 * static_cast<std::size_t>(banks_); }

  /// From one packet's stamp to the next in this mode, without loss.
  std::int64_t packet_period_ns(ReturnMode mode) const {
    return mode == ReturnMode::kDual ? dual_period_ns_ : single_period_ns_;
  }

  /// A sentence for each contradiction between configuration and packets; empty when there is none.
  const std::vector<std::string>& contradictions() const { return contradictions_; }

 private:
  void use_model(Model model);
  void use_limits();
  std::int64_t period_of(int returns) const;
  Reject check_model(std::uint8_t product_id);
  ReturnMode check_mode(std::uint8_t mode_byte);
  void note_contradiction(bool& noted, std::string text);
  void read_blocks(PacketPlan& plan) const;
  void measure_advance(PacketPlan& plan);
  void advance_by_packets(PacketPlan& plan);
  bool plausible_advance(double advance_cdeg) const;
  void smooth_advance(double advance_cdeg);
  void pass_view_gap(PacketPlan& plan, int first_group, int gap_cdeg) const;
  void prepare_motion(double advance_cdeg);

  DecoderConfig config_;
  const ModelTable* table_ = nullptr;
  int banks_ = 1;
  double group_ns_ = 0.0;
  // raw distances that count: from the lowest, so many more
  std::uint32_t lowest_raw_ = 1;
  std::uint32_t raw_span_ = 65534;
  std::array<std::int64_t, kBlocksPerPacket> group_offset_ns_{};
  std::int64_t single_period_ns_ = 0;
  std::int64_t dual_period_ns_ = 0;
  double last_advance_cdeg_ = 0.0;
  // of the packet before, for packets of one group only
  int last_azimuth_cdeg_ = -1;
  std::uint32_t last_toh_us_ = 0;
  double smooth_advance_cdeg_ = 0.0;
  bool model_noted_ = false;
  bool mode_noted_ = false;
  std::vector<std::string> contradictions_;

  // By channel. along and across: the horizontal part of the beam's direction relative to its
  // block's azimuth, with the advance up to the channel's own firing; they follow the motor speed.
  std::vector<double> correction_cos_, correction_sin_, elevation_cos_, time_share_;
  std::vector<float> along_, across_, up_, height_m_;
  std::vector<std::uint32_t> time_ns_;
  std::vector<std::uint16_t> ring_, column_;
  double prepared_advance_cdeg_ = -1.0;
  float unit_m_ = 0.0F;
};

}  // namespace zloam::driver
