#pragma once
// A matching method aligns one sweep with the sweeps inserted before.

#include <memory>

#include "common/geometry/state_bits.hpp"
#include "mapping/mapping.hpp"

namespace zloam::mapping {

/// Expected pose of the sweep before matching.
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
  /// features that were looked up, and matched features whose residual lies inside the kernel
  std::uint32_t candidates = 0;
  std::uint32_t inliers = 0;
  /// the last step was below the limits
  bool converged = true;
  /// mean robust weight of the features that were looked up: 1 when all lie in the map
  double fit = 0.0;
  /// likewise, with each point counted by itself: for comparing places
  double explained = 0.0;
  double residual_m = 0.0;
  double inlier_residual_m = 0.0;  // where the map is incomplete: of the points it knows
};

/// The clouds to insert, base_link at the instant, deskewed with the motion that the method
/// estimated.
struct InsertClouds {
  PointSpan edges;
  PointSpan planes;
};

class MappingMethod {
 public:
  virtual ~MappingMethod() = default;
  /// Aligns the sweep with the sweeps inserted before.
  virtual Match match(const MappingInput& input, const Prediction& prediction) = 0;
  /// Inserts the matched sweep into the method's own structures, before the mapper puts the
  /// returned clouds into the tile map. Spans stay valid until the next call.
  virtual InsertClouds insert(const MappingInput& input, const Match& match) = 0;
  /// Replaces match() when the sweep lies as predicted.
  virtual Match accept(const MappingInput& input, const Prediction& prediction) = 0;
  /// The search for the last matched sweep failed: the motion is unknown from there on.
  virtual void not_found() {}
  virtual void reset() = 0;
  /// From the next sweep on; existing structures keep their sizes.
  virtual void configure(const MappingConfig& config) = 0;

  /// The method's own counts, of the cubes that have grown by more than this share since they were
  /// returned last; ascending.
  virtual std::vector<VoxelTile> take_changed(double growth) = 0;
  /// Restores these counts into an empty map, before the first match.
  virtual void restore(const std::vector<VoxelTile>& tiles) = 0;

  /// Saves or restores the rest of the state after an inserted sweep; false: it is incomplete at
  /// present. Where nothing was matched yet, call prepare() first.
  virtual bool each(StateBits& bits) = 0;
  virtual void prepare(const MappingInput& input, const Pose& T_map_base) = 0;
  /// After each() restored the state of the time when this sweep was inserted: re-inserts it.
  virtual InsertClouds insert_again(const MappingInput& input, const Match& match) = 0;
};

}  // namespace zloam::mapping
