#include "driver/velodyne/decoder.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "driver/decoder/azimuth_table.hpp"
#include "driver/decoder/return_pair.hpp"

namespace zloam::driver::velodyne {
namespace {

constexpr std::size_t kAzimuthAt = 2;
constexpr std::size_t kModeAt = 1204;
constexpr std::size_t kProductAt = 1205;
// Before the wrap at the hour, real sensors have been seen to exceed it slightly.
constexpr std::uint32_t kMaxTohUs = 3'610'000'000U;

const char* mode_name(ReturnMode mode) {
  switch (mode) {
    case ReturnMode::kStrongest:
      return "strongest";
    case ReturnMode::kLast:
      return "last";
    case ReturnMode::kDual:
      return "dual";
    default:
      return "unknown";
  }
}

std::string hex(std::uint8_t value) {
  constexpr const char* kDigits = "0123456789abcdef";
  return std::string("0x") + kDigits[value >> 4] + kDigits[value & 15];
}

}  // namespace

Decoder::Decoder(const DecoderConfig& config) : config_(config) {
  if (config_.model) use_model(*config_.model);
}

void Decoder::use_model(Model model) {
  table_ = &model_table(model);
  banks_ = table_->banks;
  unit_m_ = static_cast<float>(table_->distance_unit_m);
  shape_stream();
  const double stretch = shape_.group_ns / table_->group_ns;
  stream_.emplace(
      Stream{BeamTables(*table_, stretch, config_.vertical_offsets),
             Motor(shape_.group_ns),
             raw_limits(config_.min_range_m, config_.max_range_m, table_->distance_unit_m),
             {}});
  for (int g = 0; g < kBlocksPerPacket; ++g) {
    stream_->group_offset_ns[g] = std::llround(g * shape_.group_ns) + table_->first_firing_ns;
  }
}

void Decoder::shape_stream() {
  shape_.model = table_->name;
  shape_.rings = table_->rings;
  shape_.group_ns = config_.group_ns > 0.0 ? config_.group_ns : table_->group_ns;
  shape_.groups_per_ns = 1.0 / shape_.group_ns;
  // All firings are within the first seven eighths of a group.
  shape_.group_span_ns = static_cast<std::int64_t>(shape_.group_ns) * 7 / 8;
  shape_.columns_per_group = table_->columns_per_group;
  shape_.packet_period_ns = {period_of(1), period_of(2)};
  const std::size_t cells = static_cast<std::size_t>(banks_) * std::size_t{kCellsPerBlock};
  shape_.most_points_per_group = {cells, 2 * cells};
}

std::int64_t Decoder::period_of(int returns) const {
  const int groups = kBlocksPerPacket / (returns * table_->banks);
  return std::llround(shape_.group_ns * groups);
}

void Decoder::note_contradiction(bool& noted, std::string text) {
  if (!noted && config_.says_contradictions) contradictions_.push_back(std::move(text));
  noted = true;
}

Reject Decoder::check_model(std::uint8_t product_id) {
  if (table_ && (product_id == table_->product_ids[0] || product_id == table_->product_ids[1])) {
    return Reject::kNone;
  }
  const std::optional<Model> model = model_by_product_id(product_id);
  if (config_.model && table_) {
    if (model && *model != *config_.model) {
      note_contradiction(model_noted_, "the configuration says " + std::string(table_->label) +
                                           ", the packets say " +
                                           std::string(product_label(product_id)) + " (" +
                                           hex(product_id) + "); decoded as configured");
    }
    return Reject::kNone;
  }
  if (!model) {
    note_contradiction(model_noted_, "product byte " + hex(product_id) + " (" +
                                         std::string(product_label(product_id)) +
                                         ") is no model that can be decoded; name one of " +
                                         std::string(known_model_names()) +
                                         " in the configuration");
    return Reject::kUnknownModel;
  }
  if (!table_) use_model(*model);
  return table_->model == *model ? Reject::kNone : Reject::kModelMismatch;
}

ReturnMode Decoder::check_mode(std::uint8_t mode_byte) {
  ReturnMode mode = ReturnMode::kUnknown;
  if (mode_byte == 0x37) mode = ReturnMode::kStrongest;
  if (mode_byte == 0x38) mode = ReturnMode::kLast;
  if (mode_byte == 0x39) mode = ReturnMode::kDual;
  if (!config_.return_mode) {
    if (mode == ReturnMode::kUnknown) {
      note_contradiction(mode_noted_, "return mode byte " + hex(mode_byte) +
                                          " is none of 0x37, 0x38, 0x39; name the mode in the "
                                          "configuration if the firmware has no such byte");
    }
    return mode;
  }
  if (mode != ReturnMode::kUnknown && mode != *config_.return_mode) {
    note_contradiction(mode_noted_, std::string("the configuration says return mode ") +
                                        mode_name(*config_.return_mode) + ", the packets say " +
                                        mode_name(mode) + "; decoded as configured");
  }
  return *config_.return_mode;
}

PacketTail Decoder::tail(std::span<const std::uint8_t> payload) {
  PacketTail tail;
  if (payload.size() != kDataPacketBytes) {
    const bool begins_well = payload.size() >= 2 && bank_of(payload.data()) >= 0;
    tail.reject =
        begins_well && payload.size() < kDataPacketBytes ? Reject::kShort : Reject::kForeign;
    return tail;
  }
  tail.toh_us = read_u32(payload.data() + kTimeAt);
  tail.first_azimuth_cdeg = read_u16(payload.data() + kAzimuthAt);
  tail.reject = check_model(payload[kProductAt]);
  if (tail.reject != Reject::kNone) return tail;
  tail.mode = check_mode(payload[kModeAt]);
  if (tail.mode == ReturnMode::kUnknown) tail.reject = Reject::kUnknownMode;
  if (tail.toh_us > kMaxTohUs) tail.reject = Reject::kBadTime;
  return tail;
}

PacketPlan Decoder::plan(std::span<const std::uint8_t> payload, ReturnMode mode) {
  PacketPlan plan;
  plan.payload = payload.data();
  plan.toh_us = read_u32(payload.data() + kTimeAt);
  plan.mode = mode;
  const int blocks_per_group = (mode == ReturnMode::kDual ? 2 : 1) * banks_;
  plan.groups = kBlocksPerPacket / blocks_per_group;
  plan.duration_ns = packet_period_ns(mode);
  read_blocks(plan);
  stream_->motor.measure(plan);
  plan.next_ns = plan.duration_ns;
  stream_->beams.follow(plan.advance_cdeg);
  return plan;
}

void Decoder::read_blocks(PacketPlan& plan) const {
  const int blocks_per_group = (plan.mode == ReturnMode::kDual ? 2 : 1) * banks_;
  for (int g = 0; g < plan.groups; ++g) {
    Group& group = plan.group[g];
    group.offset_ns = stream_->group_offset_ns[g];
    for (int b = 0; b < blocks_per_group; ++b) {
      const std::uint8_t* block = plan.payload + kBlockBytes * (g * blocks_per_group + b);
      const int bank = bank_of(block);
      const int azimuth_cdeg = read_u16(block + 2);
      if (bank < 0 || bank >= banks_ || azimuth_cdeg > kTurnCdeg) {
        ++plan.bad_blocks;
      } else if (!group.valid) {
        group.valid = true;
        // The manual's range ends at 35999, but sensors sometimes round up to 36000.
        group.azimuth_cdeg = azimuth_cdeg % kTurnCdeg;
      }
    }
  }
}

namespace {

/// Sets the members in place: copying a frame would stall until the stores of its members are done.
inline void set_frame(BlockFrame& frame, const PacketPlan& plan, const PlacedGroup& placed,
                      const AzimuthTable& azimuths, float unit_m) {
  const auto [cos_azimuth, sin_azimuth] = azimuths.cos_sin(plan.group[placed.group].azimuth_cdeg);
  frame.cos_azimuth = static_cast<float>(cos_azimuth);
  frame.sin_azimuth = static_cast<float>(sin_azimuth);
  frame.unit_m = unit_m;
  frame.time_ns = placed.time_ns;
  frame.column = placed.column;
}

/// Blocks of one valid group by bank and return. The block's flag decides the bank, not its
/// position in the packet.
using GroupBlocks = std::array<std::array<const std::uint8_t*, 2>, kMostBanks>;

GroupBlocks blocks_by_bank(const std::uint8_t* first, int banks, int returns) {
  GroupBlocks blocks{};
  for (int i = 0; i < banks * returns; ++i) {
    const std::uint8_t* block = first + kBlockBytes * static_cast<std::size_t>(i);
    const int bank = bank_of(block);
    if (bank < 0 || bank >= banks || read_u16(block + 2) > kTurnCdeg) continue;
    if (!blocks[bank][i % returns]) blocks[bank][i % returns] = block;
  }
  return blocks;
}

}  // namespace

std::size_t Decoder::decode_groups(const PacketPlan& plan, std::span<const PlacedGroup> groups,
                                   Point* out, std::uint16_t* columns) const {
  PointSink sink{out, columns};
  if (banks_ > 1 || plan.mode == ReturnMode::kDual) {
    for (const PlacedGroup& placed : groups) put_group(plan, placed, sink);
    return sink.count;
  }
  // With one bank and one return, a group is one block.
  std::array<FiredBlock, kBlocksPerPacket> blocks;
  const AzimuthTable& azimuths = azimuth_table();
  for (std::size_t i = 0; i < groups.size(); ++i) {
    const std::size_t at = kBlockBytes * static_cast<std::size_t>(groups[i].group);
    blocks[i].block = plan.payload + at;
    set_frame(blocks[i].frame, plan, groups[i], azimuths, unit_m_);
  }
  put_single(std::span(blocks).first(groups.size()), stream_->beams, 0, stream_->limits,
             single_type(plan.mode), sink);
  return sink.count;
}

void Decoder::put_group(const PacketPlan& plan, const PlacedGroup& placed, PointSink& sink) const {
  const int returns = plan.mode == ReturnMode::kDual ? 2 : 1;
  FiredBlock fired;
  set_frame(fired.frame, plan, placed, azimuth_table(), unit_m_);
  const std::uint8_t* const first =
      plan.payload + kBlockBytes * static_cast<std::size_t>(placed.group * banks_ * returns);
  const GroupBlocks blocks = blocks_by_bank(first, banks_, returns);
  for (int b = 0; b < banks_; ++b) {
    const auto& [last, strongest] = blocks[b];
    if (!last && !strongest) continue;
    if (returns == 1) {
      fired.block = last;
      put_single({&fired, 1}, stream_->beams, b, stream_->limits, single_type(plan.mode), sink);
    } else {
      put_dual(last, strongest, stream_->beams, b, fired.frame, stream_->limits,
               config_.dual_returns, sink);
    }
  }
}

}  // namespace zloam::driver::velodyne
