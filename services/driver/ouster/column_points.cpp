#include "driver/ouster/column_points.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <numbers>

#include "common/geometry/lanes.hpp"
#include "driver/decoder/rings.hpp"
#include "driver/ouster/column_points_wide.hpp"

namespace zloam::driver::ouster {
namespace {

constexpr std::size_t kLanes = 4;
constexpr double kMetresPerMm = 1e-3;
constexpr double kRadPerDeg = std::numbers::pi / 180.0;

// A point is written in two parts: position and intensity (16 bytes), then time, ring and type (8).
constexpr std::size_t kHalf = 16;
static_assert(offsetof(Point, time_ns) == kHalf && offsetof(Point, ring) == kHalf + 4 &&
              offsetof(Point, return_type) == kHalf + 6 && sizeof(Point) == kHalf + 8);

__attribute__((always_inline)) inline Float4 load(const float* at) {
  Float4 values;
  std::memcpy(&values, at, sizeof values);
  return values;
}

/// Four lanes: position and intensity, and the distances that decide whether they are returns.
struct Quad {
  std::array<std::uint32_t, kLanes> range_mm;
  std::array<Float4, kLanes> points;
};

__attribute__((always_inline)) inline Quad read_quad(const std::uint8_t* pixels,
                                                     const ColumnReader& reader, std::size_t lane,
                                                     const ColumnPose& pose) {
  Quad quad;
  Int4 range_mm;
  Int4 reflectivity;
  for (std::size_t i = 0; i < kLanes; ++i) {
    const std::uint8_t* const at = pixels + reader.at[lane + i];
    std::uint32_t word;
    std::memcpy(&word, at, sizeof word);
    quad.range_mm[i] = (word & reader.range_mm.mask) << reader.range_mm.shift;
    range_mm[i] = static_cast<std::int32_t>(quad.range_mm[i]);
    reflectivity[i] = at[reader.reflectivity_at];
  }
  const Float4 r = __builtin_convertvector(range_mm, Float4);
  const Float4 intensity = __builtin_convertvector(reflectivity, Float4);
  std::array<Float4, 3> local;
  for (std::size_t k = 0; k < 3; ++k) {
    local[k] = load(&reader.scale[k][lane]) * r + load(&reader.offset[k][lane]);
  }
  std::array<Float4, 3> xyz;
  for (std::size_t k = 0; k < 3; ++k) {
    const auto& row = pose.rows[k];
    xyz[k] = local[0] * row[0] + local[1] * row[1] + local[2] * row[2] + row[3];
  }
  const Float4 xy_low = __builtin_shufflevector(xyz[0], xyz[1], 0, 4, 1, 5);
  const Float4 xy_high = __builtin_shufflevector(xyz[0], xyz[1], 2, 6, 3, 7);
  const Float4 zi_low = __builtin_shufflevector(xyz[2], intensity, 0, 4, 1, 5);
  const Float4 zi_high = __builtin_shufflevector(xyz[2], intensity, 2, 6, 3, 7);
  quad.points[0] = __builtin_shufflevector(xy_low, zi_low, 0, 1, 4, 5);
  quad.points[1] = __builtin_shufflevector(xy_low, zi_low, 2, 3, 6, 7);
  quad.points[2] = __builtin_shufflevector(xy_high, zi_high, 0, 1, 4, 5);
  quad.points[3] = __builtin_shufflevector(xy_high, zi_high, 2, 3, 6, 7);
  return quad;
}

/// Writes every lane and advances only if it is kept, which is faster than a branch.
struct Writer {
  std::uint8_t* at;
  std::uint64_t time_ns;

  __attribute__((always_inline)) void put(const Float4& position_and_intensity,
                                          std::uint32_t ring_and_type, bool keep) {
    const std::uint64_t rest = time_ns | static_cast<std::uint64_t>(ring_and_type) << 32;
    std::memcpy(at, &position_and_intensity, kHalf);
    std::memcpy(at + kHalf, &rest, sizeof rest);
    at += keep ? sizeof(Point) : 0;
  }
};

/// Whether one return of a pair is kept, and with which type. which: its index, 0 or 1.
struct Choice {
  bool kept;
  ReturnType type;
};

Choice choose(std::uint32_t own_mm, std::uint32_t other_mm, std::size_t which,
              const ColumnReader& reader) {
  const PairRule& rule = reader.rule;
  const bool own = reader.limits.contain(own_mm);
  if (!reader.limits.contain(other_mm)) return {own, ReturnType::kBoth};
  if (own_mm == other_mm) return {own && which == 0, ReturnType::kBoth};
  return own_mm > other_mm ? Choice{own && rule.kept_if_farther[which], rule.type_if_farther[which]}
                           : Choice{own && rule.kept_if_nearer[which], rule.type_if_nearer[which]};
}

__attribute__((always_inline)) inline std::size_t put_column(const MeasuredColumn& column,
                                                             const ColumnReader& reader,
                                                             Point* out) {
  Writer writer{reinterpret_cast<std::uint8_t*>(out), column.time_ns};
  for (std::size_t lane = 0; lane < reader.lanes; lane += kLanes) {
    const Quad quad = read_quad(column.pixels, reader, lane, *column.pose);
    for (std::size_t i = 0; i < kLanes; ++i) {
      const std::uint32_t range_mm = quad.range_mm[i];
      const Choice choice = reader.returns == 1
                                ? Choice{reader.limits.contain(range_mm), reader.single_type}
                                : choose(range_mm, quad.range_mm[i ^ 1], i % 2, reader);
      writer.put(quad.points[i], reader.ring[lane + i] | bits_of(choice.type), choice.kept);
    }
  }
  return static_cast<std::size_t>(reinterpret_cast<Point*>(writer.at) - out);
}

RangeLimits limits_of(const DecodingOptions& options) {
  constexpr double kMmPerMetre = 1e3;
  // No profile has distances of more than 20 bits.
  constexpr double kMost = 1U << 20;
  const double lowest = std::clamp(std::ceil(kMmPerMetre * options.min_range_m - 1e-6), 1.0, kMost);
  const double highest = std::min(std::floor(kMmPerMetre * options.max_range_m + 1e-6), kMost);
  // An empty range, as no distance is this great.
  if (highest < lowest) return {1U << 21, 0};
  return {static_cast<std::uint32_t>(lowest), static_cast<std::uint32_t>(highest - lowest)};
}

}  // namespace

PairRule pair_rule(ReturnOrder order, DualReturns policy) {
  constexpr auto kBoth = ReturnType::kBoth;
  constexpr auto kLast = ReturnType::kLast;
  constexpr auto kStrongest = ReturnType::kStrongest;
  const bool by_strength = order == ReturnOrder::kStrongestFirst;
  PairRule rule{{kLast, kLast}, {kStrongest, kStrongest}, {true, true}, {true, true}};
  if (by_strength) {
    // The strongest return may also be the last one.
    rule.type_if_farther = {kBoth, kLast};
    rule.type_if_nearer = {kStrongest, ReturnType::kSecondStrongest};
  }
  if (policy == DualReturns::kBoth) {
    rule.type_if_farther = {kBoth, kBoth};
    rule.type_if_nearer = {kBoth, kBoth};
  } else if (policy == DualReturns::kLast) {
    // The only one kept of the firing: the stages that follow must not refuse it for its type.
    rule.type_if_farther = {kBoth, kBoth};
    rule.kept_if_nearer = {false, false};
  } else if (policy == DualReturns::kStrongest) {
    rule.kept_if_farther = {by_strength, false};
    rule.kept_if_nearer = {true, !by_strength};
  }
  return rule;
}

ColumnReader::ColumnReader(const Metadata& metadata, const DecodingOptions& options)
    : lanes(static_cast<std::size_t>(metadata.pixels_per_column) * metadata.profile->returns),
      words(static_cast<std::size_t>(metadata.pixels_per_column) * metadata.profile->pixel_bytes /
            4),
      returns(metadata.profile->returns),
      limits(limits_of(options)),
      range_mm(metadata.profile->fields[0].range_mm),
      reflectivity_at(metadata.profile->fields[0].reflectivity_at),
      // If a single return is not the strongest, kBoth lets later stages use it as the last or
      // strongest.
      single_type(metadata.return_order == ReturnOrder::kStrongestFirst ? ReturnType::kStrongest
                                                                        : ReturnType::kBoth),
      rule(pair_rule(metadata.return_order, options.dual_returns)) {
  const Eigen::Vector3d origin_m(metadata.beam_origin_x_m, 0.0, metadata.beam_origin_z_m);
  const std::vector<std::uint16_t> rings = rings_by_elevation(metadata.altitude_deg);
  for (std::size_t lane = 0; lane < lanes; ++lane) {
    const std::size_t pixel = lane / metadata.profile->returns;
    const std::size_t which = lane % metadata.profile->returns;
    const double altitude = kRadPerDeg * metadata.altitude_deg[pixel];
    const double azimuth = -kRadPerDeg * metadata.azimuth_deg[pixel];
    const Eigen::Vector3d direction(std::cos(altitude) * std::cos(azimuth),
                                    std::cos(altitude) * std::sin(azimuth), std::sin(altitude));
    const Eigen::Vector3d from_m = origin_m - origin_m.norm() * direction;
    for (std::size_t k = 0; k < 3; ++k) {
      const auto axis = static_cast<Eigen::Index>(k);
      scale[k].push_back(static_cast<float>(kMetresPerMm * direction(axis)));
      offset[k].push_back(static_cast<float>(from_m(axis)));
    }
    at.push_back(static_cast<std::uint32_t>(pixel * metadata.profile->pixel_bytes +
                                            metadata.profile->fields[which].range_mm.at));
    ring.push_back(rings[pixel]);
  }
}

std::vector<ColumnPose> column_poses(const Metadata& metadata) {
  std::vector<ColumnPose> poses;
  for (int m = 0; m < metadata.columns_per_frame; ++m) {
    const double encoder = -2.0 * std::numbers::pi * m / metadata.columns_per_frame;
    const Eigen::Isometry3d pose =
        metadata.T_sensor_lidar * Eigen::AngleAxisd(encoder, Eigen::Vector3d::UnitZ());
    ColumnPose column;
    for (std::size_t r = 0; r < 3; ++r) {
      for (std::size_t c = 0; c < 4; ++c) {
        column.rows[r][c] = static_cast<float>(
            pose.matrix()(static_cast<Eigen::Index>(r), static_cast<Eigen::Index>(c)));
      }
    }
    poses.push_back(column);
  }
  return poses;
}

namespace {

// Inlined into both callers, so that it is compiled for each one's instruction set; the operations
// are the same.
__attribute__((always_inline)) inline std::size_t put_all(std::span<const MeasuredColumn> columns,
                                                          const ColumnReader& reader, Point* out,
                                                          std::uint16_t* out_columns) {
  std::size_t count = 0;
  for (const MeasuredColumn& column : columns) {
    const std::size_t added = put_column(column, reader, out + count);
    std::fill_n(out_columns + count, added, column.column);
    count += added;
  }
  return count;
}

#if ZLOAM_WIDE
__attribute__((target("avx2"))) std::size_t put_columns_avx2(
    std::span<const MeasuredColumn> columns, const ColumnReader& reader, Point* out,
    std::uint16_t* out_columns) {
  return put_all(columns, reader, out, out_columns);
}
#endif

}  // namespace

std::size_t put_columns_portable(std::span<const MeasuredColumn> columns,
                                 const ColumnReader& reader, Point* out,
                                 std::uint16_t* out_columns) {
  return put_all(columns, reader, out, out_columns);
}

std::size_t put_columns(std::span<const MeasuredColumn> columns, const ColumnReader& reader,
                        Point* out, std::uint16_t* out_columns) {
#if ZLOAM_WIDE
  if (has_avx512() && reader.lanes % 16 == 0) {
    return put_columns_avx512(columns, reader, out, out_columns);
  }
  if (has_avx2()) return put_columns_avx2(columns, reader, out, out_columns);
#endif
  return put_columns_portable(columns, reader, out, out_columns);
}

}  // namespace zloam::driver::ouster
