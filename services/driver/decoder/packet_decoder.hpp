#pragma once
// From a sensor's packets to points: interface between a maker's decoder and sweep assembly.
//
// A data packet holds firing groups, the smallest pieces that a sweep can be cut between: a block
// of channels, a pair of blocks, a column. Each has one azimuth and one time. Coordinates: x
// forward (azimuth 0), y left, z up; azimuth grows clockwise.

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "common/geometry/point.hpp"

namespace zloam::driver {

inline constexpr int kTurnCdeg = 36000;
inline constexpr int kHalfTurnCdeg = kTurnCdeg / 2;
/// The most firing groups in a packet of any sensor.
inline constexpr int kMostGroups = 16;

enum class ReturnMode : std::uint8_t { kUnknown = 0, kStrongest = 1, kLast = 2, kDual = 3 };

/// Selection from the two returns of one firing.
enum class DualReturns : std::uint8_t {
  kStrongest,  // one: the strongest, or the other one, as kBoth, where that is empty
  kLast,       // one, as kBoth: the last, or the other one where that is empty
  kBoth,       // both, of equal type for the stages that follow (kBoth); equal distances once
  kTagged      // both, with their types; equal distances once, as kBoth
};

/// Why a packet was rejected.
enum class Reject : std::uint8_t {
  kNone,
  kShort,          // truncated data packet
  kForeign,        // not a packet length of this sensor
  kUnknownModel,   // of no known model, or its description is missing
  kModelMismatch,  // of another sensor than the stream's first packet or its description
  kUnknownMode,    // unknown return mode
  kBadTime,        // no plausible time stamp
};

/// Result of a short look at a packet, for ordering packets before they are decoded.
struct PacketTail {
  Reject reject = Reject::kNone;
  /// sensor's time of the packet, since the top of its hour
  std::uint32_t toh_us = 0;
  int first_azimuth_cdeg = 0;
  ReturnMode mode = ReturnMode::kUnknown;
  /// of a sensor that stamps a packet's end: time that a gap of the field of view within the packet
  /// takes, before the stamp
  std::int64_t view_gap_ns = 0;
};

/// One firing group.
struct Group {
  bool valid = false;
  int azimuth_cdeg = 0;
  /// firing of the group's first channel after the packet's stamp; less than 0: before it
  std::int64_t offset_ns = 0;
};

/// A packet made ready for decoding.
struct PacketPlan {
  const std::uint8_t* payload = nullptr;
  std::uint32_t toh_us = 0;
  ReturnMode mode = ReturnMode::kUnknown;
  int groups = 0;
  std::array<Group, kMostGroups> group;
  /// azimuth advance in one group, 0.01 degrees; 0 when unknown
  double advance_cdeg = 0.0;
  /// from this packet's stamp to the end of its last group, when it is sent
  std::int64_t duration_ns = 0;
  /// from this packet's stamp to the next one's; longer than the duration at the edge of a
  /// restricted field of view
  std::int64_t next_ns = 0;
  int bad_blocks = 0;
  /// first group after a restricted field of view's gap, or 0; the gap's time is in the offsets
  int gap_before_group = 0;
};

/// A group of a packet, and its place in its sweep.
struct PlacedGroup {
  int group;
  /// of its first firing; a point's time is that and the firing's place in the group
  std::uint32_t time_ns;
  /// of its first firings
  std::uint16_t column;
};

/// Constants of a stream, once the model is known.
struct StreamShape {
  /// as written to the sweeps; empty: not known yet
  std::string model;
  std::uint16_t rings = 0;
  /// from one firing group to the next
  double group_ns = 0.0;
  double groups_per_ns = 0.0;
  /// all firings of a group lie within this time
  std::int64_t group_span_ns = 0;
  std::uint16_t columns_per_group = 1;
  /// of a sensor that fires at fixed angles; 0: at fixed times
  int columns_per_turn = 0;
  /// from one packet's stamp to the next one's, with one and with two returns
  std::array<std::int64_t, 2> packet_period_ns{};
  std::array<std::size_t, 2> most_points_per_group{};
};

/// A time within the hour, minus a duration; the result may lie in the hour before.
inline std::uint32_t earlier_toh_us(std::uint32_t toh_us, std::uint32_t before_us) {
  constexpr std::uint32_t kHourUs = 3'600'000'000U;
  return toh_us >= before_us ? toh_us - before_us : kHourUs - (before_us - toh_us);
}

inline std::size_t returns_of(ReturnMode mode) { return mode == ReturnMode::kDual ? 2 : 1; }

/// Decodes packets of one sensor. Each virtual function is called once per packet (decode_groups
/// again where a sweep is cut), so that a maker's code runs over whole packets.
class PacketDecoder {
 public:
  PacketDecoder() = default;
  virtual ~PacketDecoder() = default;
  PacketDecoder(const PacketDecoder&) = delete;
  PacketDecoder& operator=(const PacketDecoder&) = delete;

  virtual PacketTail tail(std::span<const std::uint8_t> payload) = 0;

  /// The packet's groups, azimuths and times; payload must have passed tail() and outlive the plan.
  virtual PacketPlan plan(std::span<const std::uint8_t> payload, ReturnMode mode) = 0;

  /// Writes the returns of valid groups of the packet planned last, in time order. out and columns
  /// need room for most_points_per_group(mode) of each group, and 1. Returns the number of points.
  virtual std::size_t decode_groups(const PacketPlan& plan, std::span<const PlacedGroup> groups,
                                    Point* out, std::uint16_t* columns) const = 0;

  const StreamShape& shape() const { return shape_; }
  std::size_t most_points_per_group(ReturnMode mode) const {
    return shape_.most_points_per_group[returns_of(mode) - 1];
  }
  /// From one packet's stamp to the next in this mode, without loss; 0: not known yet.
  std::int64_t packet_period_ns(ReturnMode mode) const {
    return shape_.packet_period_ns[returns_of(mode) - 1];
  }
  /// A sentence for each contradiction between configuration and packets; empty when there is none.
  const std::vector<std::string>& contradictions() const { return contradictions_; }

 protected:
  StreamShape shape_;
  std::vector<std::string> contradictions_;
};

}  // namespace zloam::driver
