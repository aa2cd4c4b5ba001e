#include "mapping/loam_method.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

#include "mapping/alignment.hpp"
#include "mapping/degeneracy.hpp"
#include "mapping/tile_map.hpp"
#include "mapping/voxel_filter.hpp"

namespace zloam::mapping {
namespace {

constexpr double kLeastNoise_m = 0.005;
constexpr std::size_t kMaxNeighbours = 16;

struct Candidate {
  Eigen::Vector3d point_base = Eigen::Vector3d::Zero();
  bool line = false;
  bool searched = false;
  Eigen::Vector3d searched_at_map = Eigen::Vector3d::Zero();
  std::optional<Surface> surface;
};

class LoamMethod final : public MappingMethod {
 public:
  explicit LoamMethod(const MappingConfig& config) : config_(config), loam_(config.loam) {}

  Match match(const MappingInput& input, const Prediction& prediction,
              const TileMap& tiles) override;
  InsertClouds insert(const MappingInput& input, const Match&) override {
    return {input.edges, input.planes};
  }
  void reset() override { was_degenerate_ = false; }
  void configure(const MappingConfig& config) override {
    config_ = config;
    loam_ = config.loam;
  }

 private:
  std::vector<Candidate> candidates(const MappingInput& input) const;
  void associate(std::vector<Candidate>& candidates, const Pose& T_map_base, double noise_m,
                 const TileMap& tiles) const;
  std::optional<Surface> surface_at(const Eigen::Vector3d& point_map, bool line, double noise_m,
                                    const TileMap& tiles) const;
  std::vector<Residual> residuals(const std::vector<Candidate>& candidates, double noise_m) const;
  Vector6 step(const std::vector<Residual>& residuals, double kernel_m,
               const Prediction& prediction, const Pose& T_map_base) const;
  void finish(Match& match, const std::vector<Residual>& residuals, const Prediction& prediction);

  MappingConfig config_;
  LoamConfig loam_;
  bool was_degenerate_ = false;
};

std::vector<Candidate> LoamMethod::candidates(const MappingInput& input) const {
  std::vector<Candidate> all;
  for (const Eigen::Vector3d& p : voxel_means(input.edges, loam_.match_leaf_edge_m)) {
    all.push_back({p, true, false, {}, {}});
  }
  for (const Eigen::Vector3d& p : voxel_means(input.planes, loam_.match_leaf_plane_m)) {
    all.push_back({p, false, false, {}, {}});
  }
  return all;
}

std::optional<Surface> LoamMethod::surface_at(const Eigen::Vector3d& point_map, bool line,
                                              double noise_m, const TileMap& tiles) const {
  std::array<Neighbour, kMaxNeighbours> nearest;
  const auto wanted =
      static_cast<std::size_t>(std::clamp(loam_.neighbours, 3, static_cast<int>(kMaxNeighbours)));
  const std::span<Neighbour> out(nearest.data(), wanted);
  const LayerMap& layer = tiles.layer(line ? Layer::kEdge : Layer::kPlane);
  if (layer.nearest(point_map, loam_.neighbour_radius_m, out) < wanted) return std::nullopt;
  if (line) return fit_line(out, loam_.line_ratio);
  RingRange rings = out.front().rings;
  for (const Neighbour& n : out) rings.join(n.rings);
  if (loam_.plane_several_rings && rings.single()) return std::nullopt;
  return fit_plane(out, {loam_.plane_distance_m, loam_.plane_spread_ratio,
                         loam_.plane_spread_sigmas * noise_m, noise_m});
}

// Neighbours hardly change while a feature moves by a fraction of their spacing, so they are only
// searched again after a longer way.
void LoamMethod::associate(std::vector<Candidate>& candidates, const Pose& T_map_base,
                           double noise_m, const TileMap& tiles) const {
  const double squared_m2 = loam_.reassociate_m * loam_.reassociate_m;
  for (Candidate& c : candidates) {
    const Eigen::Vector3d point_map = T_map_base * c.point_base;
    if (c.searched && (point_map - c.searched_at_map).squaredNorm() < squared_m2) continue;
    c.searched = true;
    c.searched_at_map = point_map;
    c.surface =
        tiles.is_local(point_map) ? surface_at(point_map, c.line, noise_m, tiles) : std::nullopt;
  }
}

std::vector<Residual> LoamMethod::residuals(const std::vector<Candidate>& candidates,
                                            double noise_m) const {
  std::vector<Residual> all;
  all.reserve(candidates.size());
  const double information = 1.0 / (noise_m * noise_m * loam_.correlation);
  for (const Candidate& c : candidates) {
    if (!c.surface) continue;
    all.push_back(
        {c.point_base, *c.surface, c.line, c.line ? loam_.edge_weight * information : information});
  }
  return all;
}

Vector6 LoamMethod::step(const std::vector<Residual>& residuals, double kernel_m,
                         const Prediction& prediction, const Pose& T_map_base) const {
  NormalEquations equations = accumulate(residuals, T_map_base, kernel_m);
  Matrix6 strong = Matrix6::Identity();
  if (config_.weak_directions == WeakDirections::kRemap) {
    const Matrix6 noise = noise_information(residuals, T_map_base, kernel_m);
    strong = judge(equations.H, noise, prediction.covariance, config_, was_degenerate_)
                 .strong_projection;
  }
  add_prior(equations, prediction, T_map_base);
  return -(strong * equations.H.ldlt().solve(equations.g));
}

void LoamMethod::finish(Match& match, const std::vector<Residual>& residuals,
                        const Prediction& prediction) {
  NormalEquations data = accumulate(residuals, match.T_map_base, loam_.kernel_m);
  match.correspondences = static_cast<std::uint32_t>(residuals.size());
  match.inliers = data.inliers;
  match.residual_m = std::sqrt(data.squared_m2 / std::max(data.weight, 1e-12));
  match.inlier_residual_m = match.residual_m;
  match.data_information = data.H;
  match.degeneracy = judge(data.H, noise_information(residuals, match.T_map_base, loam_.kernel_m),
                           prediction.covariance, config_, was_degenerate_)
                         .report;
  was_degenerate_ = match.degeneracy.degenerate;
  add_prior(data, prediction, match.T_map_base);
  match.covariance = data.H.ldlt().solve(Matrix6::Identity());
  match.ok = match.T_map_base.matrix().allFinite() && match.covariance.allFinite();
}

Match LoamMethod::match(const MappingInput& input, const Prediction& prediction,
                        const TileMap& tiles) {
  Match match;
  match.T_map_base = prediction.T_map_base;
  const double noise_m = std::max(input.range_noise_m, kLeastNoise_m);
  std::vector<Candidate> features = candidates(input);
  match.candidates = static_cast<std::uint32_t>(features.size());
  std::vector<Residual> matched;
  double kernel_m = std::max(loam_.kernel_start_m, loam_.kernel_m);
  while (match.iterations < static_cast<std::uint32_t>(loam_.max_iterations)) {
    associate(features, match.T_map_base, noise_m, tiles);
    matched = residuals(features, noise_m);
    if (matched.size() < static_cast<std::size_t>(loam_.min_correspondences)) return match;
    const Vector6 delta = step(matched, kernel_m, prediction, match.T_map_base);
    if (!delta.allFinite()) return match;
    match.T_map_base = retract(match.T_map_base, delta);
    ++match.iterations;
    const bool still = delta.head<3>().norm() < loam_.stop_translation_m &&
                       delta.tail<3>().norm() < loam_.stop_rotation_rad;
    if (still && kernel_m <= loam_.kernel_m) break;
    kernel_m = std::max(0.5 * kernel_m, loam_.kernel_m);
  }
  finish(match, matched, prediction);
  return match;
}

}  // namespace

std::unique_ptr<MappingMethod> make_loam_method(const MappingConfig& config) {
  return std::make_unique<LoamMethod>(config);
}

}  // namespace zloam::mapping
