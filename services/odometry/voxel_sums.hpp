#pragma once
// Moments of the points in a voxel, in whole units of a grid: exact, in whatever order points and
// sums are added and taken away.

#include <Eigen/Core>
#include <array>
#include <cstdint>

#include "common/geometry/lanes.hpp"
#include "common/geometry/point.hpp"

namespace zloam::odometry {

using VoxelCell = std::array<std::int32_t, 3>;

/// Positions saturate here.
inline constexpr double kMostUnits = 2.0e9;

/// Relative to the voxel's centre.
struct VoxelSums {
  std::array<std::int64_t, 3> sum{};
  std::array<std::int64_t, 6> square{};  // xx xy xz yy yz zz
  std::int64_t count = 0;

  template <int sign>
  void add(const VoxelSums& other) {
    for (std::size_t i = 0; i < 3; ++i) sum[i] += sign * other.sum[i];
    for (std::size_t i = 0; i < 6; ++i) square[i] += sign * other.square[i];
    count += sign * other.count;
  }

  /// Points relative to a centre that lies at o from this one's: the sum of (p + o)(p + o)^T is
  /// that of p p^T and o s^T + s o^T + n o o^T.
  void add_moved(const VoxelSums& other, const std::array<std::int64_t, 3>& o) {
    const auto& s = other.sum;
    std::array<std::int64_t, 3> moved;
    for (std::size_t i = 0; i < 3; ++i) {
      moved[i] = s[i] + other.count * o[i];
      sum[i] += moved[i];
    }
    square[0] += other.square[0] + o[0] * (s[0] + moved[0]);
    square[1] += other.square[1] + o[0] * s[1] + o[1] * moved[0];
    square[2] += other.square[2] + o[0] * s[2] + o[2] * moved[0];
    square[3] += other.square[3] + o[1] * (s[1] + moved[1]);
    square[4] += other.square[4] + o[1] * s[2] + o[2] * moved[1];
    square[5] += other.square[5] + o[2] * (s[2] + moved[2]);
    count += other.count;
  }
};

/// A point in units, rounded down: whole numbers, which doubles hold exactly.
struct UnitPoint {
  Double2 xy;
  Double2 z;  // and 0
};

/// From base_link to units of the grid; positions saturate.
class ToUnits {
 public:
  ToUnits(const Eigen::Matrix3d& rotation, const Eigen::Vector3d& shift)
      : shift_{halves_of(shift)},
        columns_{halves_of(rotation.col(0)), halves_of(rotation.col(1)),
                 halves_of(rotation.col(2))} {}

  UnitPoint operator()(const Point& p) const {
    const double x = p.x, y = p.y, z = p.z;
    const auto [cx, cy, cz] = columns_;
    return {whole(cx.xy * x + (cy.xy * y + cz.xy * z) + shift_.xy),
            whole(cx.z * x + (cy.z * y + cz.z * z) + shift_.z)};
  }

 private:
  static UnitPoint halves_of(const Eigen::Vector3d& v) {
    return {Double2{v.x(), v.y()}, Double2{v.z(), 0.0}};
  }
  static Double2 whole(Double2 units) {
    const Double2 most = Double2{} + kMostUnits;
    units = units < -most ? -most : units;
    return floor_of(units > most ? most : units);
  }

  UnitPoint shift_;
  std::array<UnitPoint, 3> columns_;
};

/// Successive points of one voxel with edges of 2^shift units. Points come ring by ring, so these
/// mostly share their finest voxel: they are summed here, two numbers at once, and the voxels are
/// touched once a run. The sums stay far below 2^53 and are exact.
class VoxelRun {
 public:
  explicit VoxelRun(int shift) : shift_(shift), half_(1 << (shift - 1)) {}

  bool empty() const { return z_count_[1] == 0.0; }
  bool holds(const UnitPoint& p) const {
    return all_within(p.xy - centre_.xy, p.z - centre_.z, half_);
  }
  void begin(const UnitPoint& p) {
    *this = VoxelRun(shift_);
    const auto cell = [this](double units) { return static_cast<std::int32_t>(units) >> shift_; };
    cell_ = {cell(p.xy[0]), cell(p.xy[1]), cell(p.z[0])};
    const auto centre = [&](std::size_t i) { return 2.0 * half_ * cell_[i] + half_; };
    centre_ = {Double2{centre(0), centre(1)}, Double2{centre(2), 0.0}};
  }
  void add(const UnitPoint& p) {
    const Double2 xy = p.xy - centre_.xy;
    const Double2 z = p.z - centre_.z;
    xy_ += xy;
    z_count_ += Double2{z[0], 1.0};
    xx_yy_ += xy * xy;
    xz_yz_ += xy * z[0];
    xy_zz_ += Double2{xy[0], z[0]} * Double2{xy[1], z[0]};
  }
  const VoxelCell& cell() const { return cell_; }
  VoxelSums sums() const {
    const auto whole = [](double x) { return static_cast<std::int64_t>(x); };
    VoxelSums sums;
    sums.sum = {whole(xy_[0]), whole(xy_[1]), whole(z_count_[0])};
    sums.square = {whole(xx_yy_[0]), whole(xy_zz_[0]), whole(xz_yz_[0]),
                   whole(xx_yy_[1]), whole(xz_yz_[1]), whole(xy_zz_[1])};
    sums.count = whole(z_count_[1]);
    return sums;
  }

 private:
  static constexpr double kNowhere_units = 1e30;
  int shift_;
  double half_;
  VoxelCell cell_{};
  UnitPoint centre_{Double2{} + kNowhere_units, Double2{} + kNowhere_units};
  Double2 xy_{}, z_count_{}, xx_yy_{}, xz_yz_{}, xy_zz_{};
};

}  // namespace zloam::odometry
