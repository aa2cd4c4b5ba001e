#include "common/plane_map/normal_equations.hpp"

#include <cmath>
#include <optional>
#include <utility>

namespace zloam::plane_map {
namespace {

float squared(double x) { return static_cast<float>(x * x); }

// Row of a residual r in two halves: normal n and moment m = q x n, with the lever arm q.
struct Row {
  Float4 low;   // n_x, n_y, n_z, m_x
  Float4 high;  // m_y, m_z, r, 0
  float weight;
};

Row row_of(Float4 normal, Float4 lever, float residual, float weight) {
  const Float4 moment_zxy = cross_zxy(lever, normal);
  return {__builtin_shufflevector(normal, moment_zxy, 0, 1, 2, 5),
          __builtin_shufflevector(moment_zxy, all_lanes(residual), 2, 0, 4, 3), weight};
}

// Sums over the points of one slot, which share s: few terms, so single precision is enough. Only
// the upper part of the rows' outer products is kept: by symmetry, the low halves of the last two
// rows are contained in the others.
struct SlotSums {
  Float4 low[4] = {};
  Float4 high[6] = {};

  void add(const Row& row) {
    const Float4 l = row.low * row.weight;
    const Float4 h = row.high * row.weight;
    add_row<0>(from_lane<0>(l), row);
    add_row<1>(from_lane<1>(l), row);
    add_row<2>(from_lane<2>(l), row);
    add_row<3>(from_lane<3>(l), row);
    high[4] += from_lane<0>(h) * row.high;
    high[5] += from_lane<1>(h) * row.high;
  }

 private:
  template <int i>
  void add_row(Float4 factor, const Row& row) {
    low[i] += factor * row.low;
    high[i] += factor * row.high;
  }
};

// Sums over the slots, times powers of s: 6 rows, each of 6 columns and the right-hand side.
class SweepRows {
 public:
  void add(const SlotSums& slot, double s) {
    for (std::size_t i = 0; i < 4; ++i) add(slot.low[i], s, i, 0);
    for (std::size_t i = 0; i < 6; ++i) add(slot.high[i], s, i, 4);
  }

  void finish(NormalSums& sums) const {
    sums.a0 = symmetric(0);
    sums.a1 = symmetric(1);
    sums.a2 = symmetric(2);
    sums.a3 = symmetric(3);
    sums.a4 = symmetric(4);
    for (std::size_t i = 0; i < 6; ++i) {
      sums.g0[static_cast<Eigen::Index>(i)] = powers_[0][i][6];
      sums.g1[static_cast<Eigen::Index>(i)] = powers_[1][i][6];
      sums.g2[static_cast<Eigen::Index>(i)] = powers_[2][i][6];
    }
  }

 private:
  void add(Float4 four, double s, std::size_t row, std::size_t column) {
    const double factors[kPowers] = {1.0, s, s * s, s * s * s, s * s * s * s};
    for (std::size_t power = 0; power < kPowers; ++power) {
      for (std::size_t k = 0; k < 4; ++k) {
        powers_[power][row][column + k] += factors[power] * four[k];
      }
    }
  }

  Matrix6 symmetric(std::size_t power) const {
    Matrix6 out;
    for (std::size_t i = 0; i < 6; ++i) {
      for (std::size_t k = i; k < 6; ++k) {
        const auto [r, c] = std::pair(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(k));
        out(r, c) = out(c, r) = powers_[power][i][k];
      }
    }
    return out;
  }

  static constexpr std::size_t kPowers = 5;
  double powers_[kPowers][6][8] = {};
};

// Rotates the sums from the grid's axes to those of base_link.
void rotate(NormalSums& sums, const Eigen::Matrix3d& rotation) {
  Matrix6 b = Matrix6::Zero();
  b.topLeftCorner<3, 3>() = rotation;
  b.bottomRightCorner<3, 3>() = rotation;
  for (Matrix6* a : {&sums.a0, &sums.a1, &sums.a2, &sums.a3, &sums.a4}) {
    *a = (b.transpose() * *a * b).eval();
  }
  for (Vector6* g : {&sums.g0, &sums.g1, &sums.g2}) *g = (b.transpose() * *g).eval();
}

// Sums over the points with one kind of match: planes, or distributions.
class Accumulator {
 public:
  Accumulator(const Gate& gate, const WeakAxis& weak)
      : gate2_(squared(gate.limit_m)),
        kernel2_(squared(gate.kernel_m)),
        per_crowd_(gate.crowd_points > 0.0 ? static_cast<float>(1.0 / gate.crowd_points) : 0.0f),
        weak_axis_(lanes_of(weak.axis_grid)),
        least_cosine_(weak.axis_grid.isZero() ? 0.0f : weak.least_cosine) {}

  // lever: (q, 0); point: local, (p, 0). Returns its squared residual and weight; nothing if the
  // residual exceeds the gate.
  std::optional<std::pair<float, float>> add(const Match& match, Float4 lever, Float4 point) {
    const Float4 from_root = point - match.root_centre;
    float residuals[3] = {};
    float squared = 0.0f;
    for (int i = 0; i < match.count; ++i) {
      residuals[i] = sum_of_lanes(match.rows[i].lanes() * from_root);
      squared += residuals[i] * residuals[i];
    }
    if (!(squared <= gate2_)) {
      return std::nullopt;
    }
    const float e = kernel2_ / (kernel2_ + squared);
    const float shared_by = 1.0f + match.crowd * per_crowd_;
    const float weight = e * e / shared_by;
    for (int i = 0; i < match.count; ++i) {
      const Float4 n = match.rows[i].lanes();
      // leave_open() changes the normal only; the moment stays that of the whole normal.
      slot_.push_back(row_of(n, lever, residuals[i], weight));
      if (least_cosine_ > 0.0f) leave_open(slot_.back().low);
    }
    ++sums_.matches;
    sums_.weight += weight;
    sums_.normal_variance += weight * match.normal_variance;
    return std::pair(squared, weight);
  }

  void end_slot(std::uint32_t slot) {
    if (slot_.empty()) return;
    // A separate loop, in which the sums stay in registers.
    SlotSums sums;
    for (const Row& row : slot_) sums.add(row);
    rows_.add(sums, slot_fraction(static_cast<int>(slot)));
    slot_.clear();
  }

  NormalSums finish(const Eigen::Matrix3d& rotation) {
    rows_.finish(sums_);
    rotate(sums_, rotation);
    return sums_;
  }

 private:
  // Removes the weak axis from the row of a plane that is nearly parallel to it.
  void leave_open(Float4& row) const {
    const float along = sum_of_lanes(row * weak_axis_);
    if (std::abs(along) < least_cosine_) row -= along * weak_axis_;
  }

  float gate2_;
  float kernel2_;
  float per_crowd_;
  Float4 weak_axis_;
  float least_cosine_;
  std::vector<Row> slot_;
  SweepRows rows_;
  NormalSums sums_;
};

}  // namespace

Matrix18 NormalSums::hessian() const {
  Matrix18 h;
  h << a0, a1, 0.5 * a2, a1, a2, 0.5 * a3, 0.5 * a2, 0.5 * a3, 0.25 * a4;
  return h;
}

Vector18 NormalSums::gradient() const {
  Vector18 g;
  g << g0, g1, 0.5 * g2;
  return g;
}

void to_local(std::span<const SlotPoint> points, const SlotMotions& motions,
              const Eigen::Vector3f& shift_local, std::vector<LocalPoint>& out) {
  out.clear();
  out.reserve(points.size());
  const Float4 shift = lanes_of(shift_local);
  for (const SlotPoint& point : points) {
    const Float4 at = motions[point.slot](point.x, point.y, point.z) + shift;
    out.push_back({at[0], at[1], at[2], point.ring});
  }
}

SweepSums accumulate(VoxelPlaneMap& map, const SweepPoints& sweep, MatchedPoints& matched,
                     const SweepMotion& motion, const Gate& gate, const WeakAxis& weak) {
  const std::span<const SlotPoint> points = matched.points;
  const SlotMotions motions = sweep.motions(motion.T_mid.linear(), motion.twist, motion.bend);
  const Eigen::Vector3f shift = (motion.T_mid.translation() - map.anchor_grid()).cast<float>();
  if (std::exchange(matched.are_new, false)) {
    std::vector<LocalPoint> local;
    to_local(points, motions, shift, local);
    map.find_all(local, matched.hints);
  }
  const Float4 shift_lanes = lanes_of(shift);
  const double noise = map.config().range_noise_m;
  matched.residuals.clear();
  matched.residuals.reserve(points.size());
  Accumulator planes(gate, weak);
  Accumulator blobs({10.0 * noise, 3.0 * noise, gate.crowd_points}, {});
  const bool with_blobs = map.config().distributions;
  std::uint16_t slot = points.empty() ? std::uint16_t{0} : points.front().slot;
  const auto end_slot = [&] {
    planes.end_slot(slot);
    if (with_blobs) {
      blobs.end_slot(slot);
    }
  };
  for (std::size_t i = 0; i < points.size(); ++i) {
    const SlotPoint& point = points[i];
    if (point.slot != slot) {
      end_slot();
      slot = point.slot;
    }
    const Float4 lever = motions[slot](point.x, point.y, point.z);
    const Float4 local = lever + shift_lanes;
    const Match& match = map.find(local, matched.hints[i]);
    if (match.count == 0) continue;
    if (!match.is_plane) {
      blobs.add(match, lever, local);
    } else if (const auto counted = planes.add(match, lever, local)) {
      matched.residuals.push_back({counted->first, counted->second, sum_of_lanes(lever * lever)});
    }
  }
  end_slot();
  return {planes.finish(motion.T_mid.linear()), blobs.finish(motion.T_mid.linear())};
}

ResidualAccount account_of(std::span<const PlaneResidual> residuals, double kernel_m,
                           double fine_kernel_m) {
  const float kernel2 = squared(kernel_m), fine2 = squared(fine_kernel_m);
  ResidualAccount out;
  for (const PlaneResidual& r : residuals) {
    const float told = kernel2 / (kernel2 + r.squared_m2);
    out.told_weight += told * told;
    out.told_root += told;
    out.told_squared += told * told * r.squared_m2;
    out.told_root_squared += told * r.squared_m2;
    out.lever2 += r.weight * r.lever2_m2;
    out.fine_weight += squared(fine2 / (fine2 + r.squared_m2));
  }
  return out;
}

}  // namespace zloam::plane_map
