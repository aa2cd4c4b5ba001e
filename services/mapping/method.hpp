#pragma once
// A matching method aligns one sweep with the sweeps it has been given before.

#include <memory>

#include "common/geometry/state_bits.hpp"
#include "mapping/mapping.hpp"

namespace zloam::mapping {

/// Where the sweep should be, before it is matched.
struct Prediction {
  Pose T_map_base = Pose::Identity();
  /// tangent at base_link
  Matrix6 covariance = Matrix6::Identity();
};

struct Match {
  /// false: too few correspondences or no finite solution; the pose is then the prediction
  bool ok = false;
  Pose T_map_base = Pose::Identity();
  /// inverse of data plus prior information, tangent at base_link
  Matrix6 covariance = Matrix6::Zero();
  /// information of the data alone, tangent at base_link
  Matrix6 data_information = Matrix6::Zero();
  Degeneracy degeneracy;
  std::uint32_t iterations = 0;
  std::uint32_t correspondences = 0;
  /// features that were looked up, and matched ones whose residual lies inside the kernel
  std::uint32_t candidates = 0;
  std::uint32_t inliers = 0;
  /// the last step was below the limits
  bool converged = true;
  /// sum of the robust weights for each feature that was looked up: 1 when all lie in the map
  double fit = 0.0;
  /// likewise, but each point for itself: it compares places
  double explained = 0.0;
  double residual_m = 0.0;
  double inlier_residual_m = 0.0;  // where the map is not known everywhere: of what it knows
};

/// The clouds to be inserted, base_link at the instant, deskewed with the motion that the method
/// estimated.
struct InsertClouds {
  PointSpan edges;
  PointSpan planes;
};

class MappingMethod {
 public:
  virtual ~MappingMethod() = default;
  /// Aligns the sweep with what the method has been given before.
  virtual Match match(const MappingInput& input, const Prediction& prediction) = 0;
  /// Takes the matched sweep into the method's own structures, before the mapper puts the returned
  /// clouds into the tile map. Spans stay valid until the next call.
  virtual InsertClouds insert(const MappingInput& input, const Match& match) = 0;
  /// Instead of match(): the sweep lies as predicted.
  virtual Match accept(const MappingInput& input, const Prediction& prediction) = 0;
  /// The sweep that was matched last was searched for in vain: no motion is known from it on.
  virtual void not_found() {}
  virtual void reset() = 0;
  /// From the next sweep on; what its structures were built with stays.
  virtual void configure(const MappingConfig& config) = 0;

  /// What it has counted by itself, of the cubes in which it has grown by more than this share
  /// since it was handed out; ascending.
  virtual std::vector<VoxelTile> take_changed(double growth) = 0;
  /// Takes that back into an empty map, before the first match.
  virtual void restore(const std::vector<VoxelTile>& tiles) = 0;

  /// What it knows beside that after a sweep that was inserted, out or back; false: there is more to
  /// it just now. prepare() comes first, where nothing was matched yet.
  virtual bool each(StateBits& bits) = 0;
  virtual void prepare(const MappingInput& input, const Pose& T_map_base) = 0;
  /// After each() brought back what was known when this sweep had been inserted: inserts it as then.
  virtual InsertClouds insert_again(const MappingInput& input, const Match& match) = 0;
};

}  // namespace zloam::mapping
