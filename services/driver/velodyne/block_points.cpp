#include "driver/velodyne/block_points.hpp"

#include <array>
#include <cstddef>
#include <cstring>

#include "common/geometry/lanes.hpp"
#include "driver/velodyne/wide.hpp"

#if ZLOAM_WIDE
#include <immintrin.h>
#endif

namespace zloam::driver {
namespace {

// As many lanes as Float4.
using Ints = std::int32_t __attribute__((vector_size(16)));
using Columns = std::uint16_t __attribute__((vector_size(2 * kChannelsPerColumn)));
constexpr int kLanes = 4;
constexpr std::size_t kFlagAndAzimuthBytes = 4;
constexpr std::size_t kCellBytes = 3;

std::size_t channel_of(int bank, int cell) {
  const int channel = bank * kCellsPerBlock + cell;
  return static_cast<std::size_t>(channel);
}

/// Read where a pair has one good block only: no returns.
constexpr std::array<std::uint8_t, kBlockBytes + 1> kEmptyBlock{};

// The two halves of a point as it lies in memory, written at once each: member by member it takes
// twice as long.
constexpr std::size_t kHalf = 16;
static_assert(offsetof(Point, time_ns) == kHalf && offsetof(Point, ring) == kHalf + 4 &&
              offsetof(Point, return_type) == kHalf + 6 && sizeof(Point) == kHalf + 8);

std::uint64_t type_bits(ReturnType type) { return static_cast<std::uint64_t>(type) << 48; }

Float4 load(const float* at) {
  Float4 values;
  std::memcpy(&values, at, sizeof values);
  return values;
}

/// A cell with one byte beyond it: raw distance, then intensity. A block is followed by another one
/// or by the packet's tail.
std::uint32_t read_cell(const std::uint8_t* at) {
  std::uint32_t cell;
  std::memcpy(&cell, at, sizeof cell);
  return cell;
}

/// Position and intensity of four cells; raw 0 is no return.
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

/// Every cell is written and kept only when it is a return: cheaper than a branch that is taken
/// half of the time.
struct Writer {
  std::uint8_t* begin;
  std::uint8_t* at;
  std::uint16_t* columns;

  explicit Writer(const PointSink& sink)
      : begin(reinterpret_cast<std::uint8_t*>(sink.points)),
        at(begin + sizeof(Point) * sink.count),
        columns(sink.columns) {}

  std::size_t count() const { return static_cast<std::size_t>(at - begin) / sizeof(Point); }

  void put(const Float4& position_and_intensity, std::uint64_t rest, bool keep) {
    std::memcpy(at, &position_and_intensity, kHalf);
    std::memcpy(at + kHalf, &rest, sizeof rest);
    at += keep ? sizeof(Point) : 0;
  }

  /// Of the points that come next, as many as the channels of one column can give.
  void fill_columns(std::uint16_t column, int returns) {
    const Columns filled = column - Columns{};
    std::uint16_t* to = columns + count();
    for (int i = 0; i < returns; ++i) {
      std::memcpy(to + std::ptrdiff_t{kChannelsPerColumn} * i, &filled, sizeof filled);
    }
  }
};

std::uint16_t column_of(const BlockFrame& frame, const BeamTables& beams, std::size_t channel) {
  return static_cast<std::uint16_t>(frame.column + beams.column[channel / kChannelsPerColumn]);
}

/// Which of two returns is given, and as what.
struct Choice {
  bool last;
  bool strongest;
  std::uint64_t last_type;
  std::uint64_t strongest_type;
};

// Equal distances are one return (VLP-16 manual p. 57).
Choice choose(bool last, bool strongest, bool same, DualReturns policy) {
  const bool both = policy == DualReturns::kBoth || same;
  Choice choice{last, strongest && !same, type_bits(both ? ReturnType::kBoth : ReturnType::kLast),
                type_bits(both ? ReturnType::kBoth : ReturnType::kStrongest)};
  if (policy == DualReturns::kStrongest && choice.strongest) choice.last = false;
  if (policy == DualReturns::kLast && choice.last) choice.strongest = false;
  return choice;
}

#if ZLOAM_WIDE

/// Eight cells as eight lanes, with four bytes beyond the last one read, where the processor can
/// (two thirds of the time of four lanes). The operations are the same, one by one, and so are the
/// results to the last bit.
struct Wide {
  __m256 points[4];
  __m256i rests[2];
  unsigned kept;
};

__attribute__((target("avx2"), always_inline)) inline Wide read_wide(
    const std::uint8_t* cells, const BeamTables& beams, std::size_t channel,
    const BlockFrame& frame, RawLimits limits, __m256i common) {
  const __m256i raw_bytes = _mm256_broadcastsi128_si256(
      _mm_setr_epi8(0, 1, -1, -1, 3, 4, -1, -1, 6, 7, -1, -1, 9, 10, -1, -1));
  const __m256i intensity_bytes = _mm256_broadcastsi128_si256(
      _mm_setr_epi8(2, -1, -1, -1, 5, -1, -1, -1, 8, -1, -1, -1, 11, -1, -1, -1));
  const auto load_cells = [](const std::uint8_t* at) {
    return _mm_loadu_si128(reinterpret_cast<const __m128i*>(at));
  };
  const __m256i packed = _mm256_set_m128i(load_cells(cells + 4 * kCellBytes), load_cells(cells));
  const __m256i raw = _mm256_shuffle_epi8(packed, raw_bytes);
  const auto lowest = static_cast<int>(limits.lowest);
  const __m256i is_kept = _mm256_and_si256(
      _mm256_cmpgt_epi32(raw, _mm256_set1_epi32(lowest - 1)),
      _mm256_cmpgt_epi32(_mm256_set1_epi32(lowest + static_cast<int>(limits.span) + 1), raw));
  const __m256 intensity = _mm256_cvtepi32_ps(_mm256_shuffle_epi8(packed, intensity_bytes));
  const __m256 range_m = _mm256_cvtepi32_ps(raw) * frame.unit_m;
  const __m256 along = _mm256_loadu_ps(&beams.along[channel]);
  const __m256 across = _mm256_loadu_ps(&beams.across[channel]);
  const __m256 x = range_m * (along * frame.cos_azimuth - across * frame.sin_azimuth);
  const __m256 y = -range_m * (along * frame.sin_azimuth + across * frame.cos_azimuth);
  const __m256 z =
      range_m * _mm256_loadu_ps(&beams.up[channel]) + _mm256_loadu_ps(&beams.height_m[channel]);
  const __m256 xy_low = _mm256_unpacklo_ps(x, y);
  const __m256 xy_high = _mm256_unpackhi_ps(x, y);
  const __m256 zi_low = _mm256_unpacklo_ps(z, intensity);
  const __m256 zi_high = _mm256_unpackhi_ps(z, intensity);
  const auto* rest = reinterpret_cast<const __m256i*>(&beams.time_and_ring[channel]);
  return {{_mm256_shuffle_ps(xy_low, zi_low, 0x44), _mm256_shuffle_ps(xy_low, zi_low, 0xEE),
           _mm256_shuffle_ps(xy_high, zi_high, 0x44), _mm256_shuffle_ps(xy_high, zi_high, 0xEE)},
          {_mm256_add_epi64(_mm256_loadu_si256(rest), common),
           _mm256_add_epi64(_mm256_loadu_si256(rest + 1), common)},
          static_cast<unsigned>(_mm256_movemask_ps(_mm256_castsi256_ps(is_kept)))};
}

__attribute__((target("avx2"), always_inline)) inline void put_pair(Writer& writer, __m128 first,
                                                                    __m128 second, __m128i rests,
                                                                    unsigned kept) {
  _mm_storeu_ps(reinterpret_cast<float*>(writer.at), first);
  _mm_storel_epi64(reinterpret_cast<__m128i*>(writer.at + kHalf), rests);
  writer.at += kept & 1 ? sizeof(Point) : 0;
  _mm_storeu_ps(reinterpret_cast<float*>(writer.at), second);
  _mm_storeh_pd(reinterpret_cast<double*>(writer.at + kHalf), _mm_castsi128_pd(rests));
  writer.at += kept & 2 ? sizeof(Point) : 0;
}

__attribute__((target("avx2"))) void put_single_wide(const std::uint8_t* block,
                                                     const BeamTables& beams, int bank,
                                                     const BlockFrame& frame, RawLimits limits,
                                                     ReturnType type, PointSink& sink) {
  const __m256i common =
      _mm256_set1_epi64x(static_cast<long long>(frame.time_ns | type_bits(type)));
  Writer writer(sink);
  for (int c = 0; c < kCellsPerBlock; c += 2 * kLanes) {
    const std::size_t channel = channel_of(bank, c);
    if (c % kChannelsPerColumn == 0) writer.fill_columns(column_of(frame, beams, channel), 1);
    const std::uint8_t* cells =
        block + kFlagAndAzimuthBytes + kCellBytes * static_cast<std::size_t>(c);
    const Wide wide = read_wide(cells, beams, channel, frame, limits, common);
    // Lanes 0 to 3 are the low half of each, lanes 4 to 7 the high half.
    put_pair(writer, _mm256_castps256_ps128(wide.points[0]), _mm256_castps256_ps128(wide.points[1]),
             _mm256_castsi256_si128(wide.rests[0]), wide.kept);
    put_pair(writer, _mm256_castps256_ps128(wide.points[2]), _mm256_castps256_ps128(wide.points[3]),
             _mm256_extracti128_si256(wide.rests[0], 1), wide.kept >> 2);
    put_pair(writer, _mm256_extractf128_ps(wide.points[0], 1),
             _mm256_extractf128_ps(wide.points[1], 1), _mm256_castsi256_si128(wide.rests[1]),
             wide.kept >> 4);
    put_pair(writer, _mm256_extractf128_ps(wide.points[2], 1),
             _mm256_extractf128_ps(wide.points[3], 1), _mm256_extracti128_si256(wide.rests[1], 1),
             wide.kept >> 6);
  }
  sink.count = writer.count();
}

#endif

}  // namespace

void put_single(const std::uint8_t* block, const BeamTables& beams, int bank,
                const BlockFrame& frame, RawLimits limits, ReturnType type, PointSink& sink) {
#if ZLOAM_WIDE
  if (has_wide()) {
    put_single_wide(block, beams, bank, frame, limits, type, sink);
    return;
  }
#endif
  put_single_portable(block, beams, bank, frame, limits, type, sink);
}

void put_single_portable(const std::uint8_t* block, const BeamTables& beams, int bank,
                         const BlockFrame& frame, RawLimits limits, ReturnType type,
                         PointSink& sink) {
  // Time is below 2^32 with any channel's added to it: nothing carries over into the ring.
  const std::uint64_t common = frame.time_ns | type_bits(type);
  Writer writer(sink);
  for (int c = 0; c < kCellsPerBlock; c += kLanes) {
    const std::size_t channel = channel_of(bank, c);
    if (c % kChannelsPerColumn == 0) writer.fill_columns(column_of(frame, beams, channel), 1);
    const Quad quad = read_quad(block, c, beams, channel, frame);
    for (std::size_t i = 0; i < kLanes; ++i) {
      writer.put(quad.points[i], beams.time_and_ring[channel + i] + common,
                 limits.contain(quad.raw[i]));
    }
  }
  sink.count = writer.count();
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
      const Choice choice = choose(limits.contain(last.raw[i]), limits.contain(strongest.raw[i]),
                                   last.raw[i] == strongest.raw[i], policy);
      const std::uint64_t rest = beams.time_and_ring[channel + i] + frame.time_ns;
      writer.put(last.points[i], rest + choice.last_type, choice.last);
      writer.put(strongest.points[i], rest + choice.strongest_type, choice.strongest);
    }
  }
  sink.count = writer.count();
}

}  // namespace zloam::driver
