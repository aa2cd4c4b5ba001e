#include "driver/velodyne/block_points.hpp"

#include <array>
#include <cstddef>
#include <cstring>

#include "driver/decoder/return_pair.hpp"
#include "driver/velodyne/block_points_wide.hpp"
#include "driver/velodyne/block_writer.hpp"

namespace zloam::driver::velodyne {
namespace {

// Has as many lanes as Float4.
using Ints = std::int32_t __attribute__((vector_size(16)));
constexpr int kLanes = 4;
/// A block without returns, read in place of the missing one if only one block of a pair is valid.
constexpr std::array<std::uint8_t, kBlockBytes + 1> kEmptyBlock{};

Float4 load(const float* at) {
  Float4 values;
  std::memcpy(&values, at, sizeof values);
  return values;
}

/// Reads a cell (raw distance, then intensity) and one byte beyond it, which exists: a block is
/// followed by another one or by the packet's tail.
std::uint32_t read_cell(const std::uint8_t* at) {
  std::uint32_t cell;
  std::memcpy(&cell, at, sizeof cell);
  return cell;
}

/// Position and intensity of four cells; a raw distance of 0 means no return.
struct Quad {
  std::uint32_t raw[kLanes];
  Float4 points[kLanes];
};

__attribute__((always_inline)) inline Quad read_quad(const std::uint8_t* block, int c,
                                                     const BeamTables& beams, std::size_t channel,
                                                     const BlockFrame& frame) {
  Quad quad;
  Ints packed;
  for (int i = 0; i < kLanes; ++i) {
    const std::uint32_t cell =
        read_cell(block + kFlagAndAzimuthBytes + kCellBytes * static_cast<std::size_t>(c + i));
    quad.raw[i] = cell & 0xFFFF;
    packed[i] = static_cast<std::int32_t>(cell);
  }
  const Float4 intensity = __builtin_convertvector((packed >> 16) & 0xFF, Float4);
  const Float4 range_m = __builtin_convertvector(packed & 0xFFFF, Float4) * frame.unit_m;
  const Float4 along = load(&beams.along[channel]);
  const Float4 across = load(&beams.across[channel]);
  const Float4 x = range_m * (along * frame.cos_azimuth - across * frame.sin_azimuth);
  const Float4 y = -range_m * (along * frame.sin_azimuth + across * frame.cos_azimuth);
  const Float4 z = range_m * load(&beams.up[channel]) + load(&beams.height_m[channel]);
  const Float4 xy_low = __builtin_shufflevector(x, y, 0, 4, 1, 5);
  const Float4 xy_high = __builtin_shufflevector(x, y, 2, 6, 3, 7);
  const Float4 zi_low = __builtin_shufflevector(z, intensity, 0, 4, 1, 5);
  const Float4 zi_high = __builtin_shufflevector(z, intensity, 2, 6, 3, 7);
  quad.points[0] = __builtin_shufflevector(xy_low, zi_low, 0, 1, 4, 5);
  quad.points[1] = __builtin_shufflevector(xy_low, zi_low, 2, 3, 6, 7);
  quad.points[2] = __builtin_shufflevector(xy_high, zi_high, 0, 1, 4, 5);
  quad.points[3] = __builtin_shufflevector(xy_high, zi_high, 2, 3, 6, 7);
  return quad;
}

void put_block(const FiredBlock& fired, const BeamTables& beams, int bank, RawLimits limits,
               ReturnType type, Writer& writer) {
  const auto& [block, frame] = fired;
  for (int c = 0; c < kCellsPerBlock; c += kLanes) {
    const std::size_t channel = channel_of(bank, c);
    if (c % kChannelsPerColumn == 0) writer.fill_columns(column_of(frame, beams, channel), 1);
    const Quad quad = read_quad(block, c, beams, channel, frame);
    for (std::size_t i = 0; i < kLanes; ++i) {
      const std::uint64_t rest = rest_of(beams.time_ns[channel + i] + frame.time_ns,
                                         beams.ring[channel + i] | type_bits(type));
      writer.put(quad.points[i], rest, limits.contain(quad.raw[i]));
    }
  }
}

}  // namespace

void put_single(std::span<const FiredBlock> blocks, const BeamTables& beams, int bank,
                RawLimits limits, ReturnType type, PointSink& sink) {
#if ZLOAM_WIDE
  if (has_avx512()) return put_single_avx512(blocks, beams, bank, limits, type, sink);
  if (has_avx2()) return put_single_avx2(blocks, beams, bank, limits, type, sink);
#endif
  put_single_portable(blocks, beams, bank, limits, type, sink);
}

void put_single_portable(std::span<const FiredBlock> blocks, const BeamTables& beams, int bank,
                         RawLimits limits, ReturnType type, PointSink& sink) {
  Writer writer(sink);
  for (const FiredBlock& fired : blocks) put_block(fired, beams, bank, limits, type, writer);
  sink.count = writer.count;
}

void put_dual(const std::uint8_t* last_block, const std::uint8_t* strongest_block,
              const BeamTables& beams, int bank, const BlockFrame& frame, RawLimits limits,
              DualReturns policy, PointSink& sink) {
  if (!last_block) last_block = kEmptyBlock.data();
  if (!strongest_block) strongest_block = kEmptyBlock.data();
  Writer writer(sink);
  for (int c = 0; c < kCellsPerBlock; c += kLanes) {
    const std::size_t channel = channel_of(bank, c);
    if (c % kChannelsPerColumn == 0) writer.fill_columns(column_of(frame, beams, channel), 2);
    const Quad last = read_quad(last_block, c, beams, channel, frame);
    const Quad strongest = read_quad(strongest_block, c, beams, channel, frame);
    for (std::size_t i = 0; i < kLanes; ++i) {
      const PairChoice choice =
          choose(limits.contain(last.raw[i]), limits.contain(strongest.raw[i]),
                 last.raw[i] == strongest.raw[i], policy);
      const std::uint32_t time_ns = beams.time_ns[channel + i] + frame.time_ns;
      const std::uint32_t ring = beams.ring[channel + i];
      writer.put(last.points[i], rest_of(time_ns, ring | type_bits(choice.last_type)), choice.last);
      writer.put(strongest.points[i], rest_of(time_ns, ring | type_bits(choice.strongest_type)),
                 choice.strongest);
    }
  }
  sink.count = writer.count;
}

}  // namespace zloam::driver::velodyne
