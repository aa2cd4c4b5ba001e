#include "common/plane_map/normal_equations.hpp"

#include <cmath>
#include <utility>

namespace zloam::plane_map {
namespace {

// Sums over the points of one slot, which share s. Few terms meet here, so single precision is
// enough and four lanes wide; column 6 is the right-hand side.
struct SlotSums {
  alignas(16) float rows[6][8] = {};

  void add(const float (&j)[8], float weight) {
    for (int i = 0; i < 6; ++i) {
      const float wi = weight * j[i];
      for (int k = 0; k < 8; ++k) {
        rows[i][k] += wi * j[k];
      }
    }
  }
};

void flush(SlotSums& slot, double s, NormalSums& sums) {
  for (int i = 0; i < 6; ++i) {
    for (int k = 0; k < 6; ++k) {
      const double a = slot.rows[i][k];
      sums.a0(i, k) += a;
      sums.a1(i, k) += s * a;
      sums.a2(i, k) += s * s * a;
    }
    const double g = slot.rows[i][6];
    sums.g0[i] += g;
    sums.g1[i] += s * g;
  }
  slot = SlotSums();
}

// From axes of the grid to axes of base_link.
void rotate(NormalSums& sums, const Eigen::Matrix3d& rotation) {
  Matrix6 b = Matrix6::Zero();
  b.topLeftCorner<3, 3>() = rotation;
  b.bottomRightCorner<3, 3>() = rotation;
  for (Matrix6* a : {&sums.a0, &sums.a1, &sums.a2}) {
    *a = (b.transpose() * *a * b).eval();
  }
  sums.g0 = (b.transpose() * sums.g0).eval();
  sums.g1 = (b.transpose() * sums.g1).eval();
}

// Row [J, r, 0] of a residual: normal and lever arm x normal.
void fill_row(const PlaneRow& n, const std::array<float, 3>& q, float residual, float (&j)[8]) {
  j[0] = n.nx;
  j[1] = n.ny;
  j[2] = n.nz;
  j[3] = q[1] * n.nz - q[2] * n.ny;
  j[4] = q[2] * n.nx - q[0] * n.nz;
  j[5] = q[0] * n.ny - q[1] * n.nx;
  j[6] = residual;
  j[7] = 0.0f;
}

// Points of one kind of match.
class Accumulator {
 public:
  Accumulator(double gate_m, double kernel_m, const WeakAxis& weak)
      : gate2_(static_cast<float>(gate_m * gate_m)),
        kernel2_(static_cast<float>(kernel_m * kernel_m)),
        weak_axis_(weak.axis_grid),
        least_cosine_(weak.axis_grid.isZero() ? 0.0f : weak.least_cosine) {}

  // q: lever arm; p: the point relative to the root voxel's centre.
  void add(const Match& match, const std::array<float, 3>& q, const std::array<float, 3>& p) {
    float residuals[3] = {};
    float squared = 0.0f;
    for (int i = 0; i < match.count; ++i) {
      const PlaneRow& n = match.rows[i];
      residuals[i] = n.nx * p[0] + n.ny * p[1] + n.nz * p[2] - n.d;
      squared += residuals[i] * residuals[i];
    }
    if (!(squared <= gate2_)) {
      return;
    }
    const float e = kernel2_ / (kernel2_ + squared);
    const float weight = e * e;
    for (int i = 0; i < match.count; ++i) {
      alignas(16) float j[8];
      fill_row(match.rows[i], q, residuals[i], j);
      if (least_cosine_ > 0.0f) leave_open(j);
      slot_.add(j, weight);
    }
    slot_is_empty_ = false;
    ++sums_.matches;
    sums_.cost += 0.5 * e * squared;
    sums_.weight += weight;
    sums_.squared += weight * squared;
    sums_.normal_variance += weight * match.normal_variance;
    sums_.lever2 += weight * (q[0] * q[0] + q[1] * q[1] + q[2] * q[2]);
  }

  void end_slot(std::uint32_t slot) {
    if (!slot_is_empty_) flush(slot_, slot_fraction(static_cast<int>(slot)), sums_);
    slot_is_empty_ = true;
  }

  NormalSums finish(const Eigen::Matrix3d& rotation) {
    rotate(sums_, rotation);
    return sums_;
  }

 private:
  // Takes the weak axis out of the row of a plane that lies along it.
  void leave_open(float (&j)[8]) const {
    const Eigen::Vector3f& a = weak_axis_;
    const float along = j[0] * a[0] + j[1] * a[1] + j[2] * a[2];
    if (std::abs(along) >= least_cosine_) {
      return;
    }
    for (int i = 0; i < 3; ++i) {
      j[i] -= along * a[i];
    }
  }

  float gate2_;
  float kernel2_;
  Eigen::Vector3f weak_axis_;
  float least_cosine_;
  SlotSums slot_;
  bool slot_is_empty_ = true;
  NormalSums sums_;
};

}  // namespace

Matrix12 NormalSums::hessian() const {
  Matrix12 h;
  h << a0, a1, a1, a2;
  return h;
}

Vector12 NormalSums::gradient() const {
  Vector12 g;
  g << g0, g1;
  return g;
}

void to_local(const std::vector<SlotPoint>& points, const SlotMotions& motions,
              const Eigen::Vector3f& shift_local, std::vector<LocalPoint>& out) {
  out.clear();
  out.reserve(points.size());
  for (const SlotPoint& point : points) {
    const std::array<float, 3> q = motions[point.slot](point);
    out.push_back(
        {q[0] + shift_local.x(), q[1] + shift_local.y(), q[2] + shift_local.z(), point.ring});
  }
}

SweepSums accumulate(VoxelPlaneMap& map, const SweepPoints& sweep, MatchedPoints& matched,
                     const SweepMotion& motion, double gate_m, const WeakAxis& weak) {
  const std::vector<SlotPoint>& points = matched.points;
  const SlotMotions motions = sweep.motions(motion.T_mid.linear(), motion.twist);
  const Eigen::Vector3f shift = (motion.T_mid.translation() - map.anchor_grid()).cast<float>();
  if (std::exchange(matched.are_new, false)) {
    std::vector<LocalPoint> local;
    to_local(points, motions, shift, local);
    map.find_all(local, matched.hints);
  }
  const double noise = map.config().range_noise_m;
  Accumulator planes(gate_m, gate_m / 3.0, weak);
  Accumulator blobs(10.0 * noise, 3.0 * noise, {});
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
    const std::array<float, 3> q = motions[slot](point);
    const float x = q[0] + shift.x();
    const float y = q[1] + shift.y();
    const float z = q[2] + shift.z();
    const Match& match = map.find(x, y, z, matched.hints[i]);
    if (match.count > 0) {
      const std::array<float, 3>& c = match.root_centre;
      (match.is_plane ? planes : blobs).add(match, q, {x - c[0], y - c[1], z - c[2]});
    }
  }
  end_slot();
  return {planes.finish(motion.T_mid.linear()), blobs.finish(motion.T_mid.linear())};
}

}  // namespace zloam::plane_map
