#pragma once
// Converts the pixels of a column to points.
//
// A pixel's beam is fixed in a frame that rotates with the rotor. With the encoder's angle e
// (opposite to the column's number: columns go clockwise), the beam's azimuth a and altitude b, the
// origin n of the beams and the measured distance r, which counts from the lidar's axis:
//
//   local  = (r - |n|) (cos b cos a, cos b sin a, sin b) + n
//   p      = T_sensor_lidar Rz(e) local
//
// local is linear in r: its coefficients are kept per pixel, and T_sensor_lidar Rz(e) per column.

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "common/geometry/point.hpp"
#include "driver/decoder/maker.hpp"
#include "driver/ouster/metadata.hpp"

namespace zloam::driver::ouster {

/// Distances that count as returns, in mm; 0 never does.
struct RangeLimits {
  std::uint32_t lowest_mm = 1;
  std::uint32_t span_mm = 0;
  bool contain(std::uint32_t range_mm) const { return range_mm - lowest_mm <= span_mm; }
};

/// Selection from two different returns of a pixel; by 0: the first, 1: the second of them. A
/// single return, or two equal ones, are one, kBoth.
struct PairRule {
  std::array<ReturnType, 2> type_if_farther;
  std::array<ReturnType, 2> type_if_nearer;
  std::array<bool, 2> kept_if_farther;
  std::array<bool, 2> kept_if_nearer;
};

/// If two returns are ordered by distance, the strongest is unknown, and the nearer one is treated
/// as the strongest.
PairRule pair_rule(ReturnOrder order, DualReturns policy);

/// Constants of all columns. A lane is one return of one pixel; a pixel's lanes are neighbours.
/// local = scale r + offset.
struct ColumnReader {
  ColumnReader(const Metadata& metadata, const DecodingOptions& options);

  std::size_t lanes;
  /// number of four-byte words of all pixels
  std::size_t words;
  int returns;
  RangeLimits limits;
  Bits range_mm;
  /// offset of the reflectivity's byte after a lane's first
  std::size_t reflectivity_at;
  ReturnType single_type;
  PairRule rule;
  /// first byte of each lane in the column's pixels; begins with a word
  std::vector<std::uint32_t> at;
  /// x, y, z in m; r in mm
  std::array<std::vector<float>, 3> scale;
  std::array<std::vector<float>, 3> offset;
  /// rank by ascending altitude
  std::vector<std::uint32_t> ring;
};

/// Pose of a column's beams: rows of T_sensor_lidar Rz(e), with the translation last.
struct ColumnPose {
  std::array<std::array<float, 4>, 3> rows;
};

std::vector<ColumnPose> column_poses(const Metadata& metadata);

/// A column of a packet, and values common to its points.
struct MeasuredColumn {
  const std::uint8_t* pixels;
  const ColumnPose* pose;
  std::uint32_t time_ns;
  std::uint16_t column;
};

/// Writes the returns of the columns, one column after the other. There must be room for all lanes
/// of all columns, and for one more point. Returns their number.
std::size_t put_columns(std::span<const MeasuredColumn> columns, const ColumnReader& reader,
                        Point* out, std::uint16_t* out_columns);

/// The same with four lanes on any processor; put_columns must agree with it bit-exactly.
std::size_t put_columns_portable(std::span<const MeasuredColumn> columns,
                                 const ColumnReader& reader, Point* out,
                                 std::uint16_t* out_columns);

}  // namespace zloam::driver::ouster
