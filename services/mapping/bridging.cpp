#include "mapping/bridging.hpp"

namespace zloam::mapping {
namespace {

// Sweeps that are searched for before the search widens, and how wide it gets before it begins
// again.
constexpr std::uint32_t kSweepsOfAWidth = 3;
constexpr std::uint32_t kWidths = 4;

std::vector<Pose> starts(const MappingConfig& config, std::uint32_t attempt) {
  const double width = 1.0 + static_cast<double>(attempt / kSweepsOfAWidth % kWidths);
  std::vector<Pose> offsets = {Pose::Identity()};
  for (const int yaw : {0, -1, 1}) {
    for (int i = -2; i <= 2; ++i) {
      for (int j = -2; j <= 2; ++j) {
        Pose offset = Pose::Identity();
        offset.translation() = 0.5 * width * config.bridge_distance_m * Eigen::Vector3d(i, j, 0);
        offset.linear() =
            exp_so3(Eigen::Vector3d(0.0, 0.0, yaw * width * config.bridge_rotation_rad));
        if (yaw != 0 || i != 0 || j != 0) offsets.push_back(offset);
      }
    }
  }
  return offsets;
}

bool accepted(const Match& match, const MappingConfig& config, double median_residual_m,
              const FitRecord& fits) {
  if (!match.ok || match.candidates == 0) return false;
  const double ratio = static_cast<double>(match.inliers) / match.candidates;
  const bool near = median_residual_m <= 0.0 ||
                    match.inlier_residual_m < config.insert_residual_factor * median_residual_m;
  return near && ratio >= config.bridge_inlier_ratio && !explains_too_little(match, fits);
}

}  // namespace

bool explains_too_little(const Match& match, const FitRecord& fits) {
  // Right matches explain 0.85 of the usual and more, wrong ones up to 0.7
  // (docs/experiments/2026-11-26-lost-by-fit.md).
  constexpr double kTooLittle = 0.75;
  return fits.usual() && match.fit < kTooLittle * *fits.usual();
}

Matrix6 bridge_covariance(const MappingConfig& config) {
  Matrix6 covariance = Matrix6::Zero();
  covariance.diagonal().head<3>().setConstant(config.bridge_distance_m * config.bridge_distance_m);
  covariance.diagonal().tail<3>().setConstant(config.bridge_rotation_rad *
                                              config.bridge_rotation_rad);
  return covariance;
}

Match bridge(MappingMethod& method, const MappingInput& input, const Prediction& guess,
             const MappingConfig& config, double median_residual_m, const FitRecord& fits,
             std::uint32_t attempt) {
  Match best;
  bool best_accepted = false;
  for (const Pose& offset : starts(config, attempt)) {
    Prediction start = guess;
    start.T_map_base = guess.T_map_base * offset;
    const Match match = method.match(input, start);
    const bool good = accepted(match, config, median_residual_m, fits);
    if (good && (!best_accepted || match.inliers > best.inliers)) {
      best = match;
      best_accepted = true;
    }
    if (good && offset.isApprox(Pose::Identity())) break;
  }
  best.ok = best_accepted;
  if (!best_accepted) best.T_map_base = guess.T_map_base;
  return best;
}

}  // namespace zloam::mapping
