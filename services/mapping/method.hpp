#pragma once
// What a matching method is to the mapper: it aligns one sweep with what it has been given before.

#include <memory>

#include "mapping/mapping.hpp"

namespace zloam::mapping {

class TileMap;

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
  double residual_m = 0.0;
  double inlier_residual_m = 0.0;  // where the map is not known everywhere: of what it knows
};

/// The clouds to be inserted, base_link at the instant. A method that estimates the sweep's motion
/// anew returns its own; the others return what came in.
struct InsertClouds {
  PointSpan edges;
  PointSpan planes;
};

class MappingMethod {
 public:
  virtual ~MappingMethod() = default;
  /// Aligns the sweep. The tile map is the common store of points; a method may use one of its own.
  virtual Match match(const MappingInput& input, const Prediction& prediction,
                      const TileMap& tiles) = 0;
  /// Takes the matched sweep into the method's own structures, before the mapper puts the returned
  /// clouds into the tile map. Spans stay valid until the next call.
  virtual InsertClouds insert(const MappingInput& input, const Match& match) = 0;
  /// The sweep that was matched last was searched for in vain: no motion is known from it on.
  virtual void not_found() {}
  virtual void reset() = 0;
  /// From the next sweep on; what its structures were built with stays.
  virtual void configure(const MappingConfig& config) = 0;

  /// What it has counted by itself, of the cubes in which it has grown by more than this share
  /// since it was handed out; ascending. A method that matches against the tiles' points has
  /// nothing.
  virtual std::vector<VoxelTile> take_changed(double /*growth*/) { return {}; }
  /// Takes that back into an empty map, before the first match.
  virtual void restore(const std::vector<VoxelTile>& /*tiles*/) {}
};

/// What mapping.method may be.
std::vector<std::string> method_names();

/// The method that the configuration names; throws std::invalid_argument for an unknown name.
std::unique_ptr<MappingMethod> make_method(const MappingConfig& config);

}  // namespace zloam::mapping
