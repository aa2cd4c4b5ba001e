#include "odometry/matcher.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

#include "common/containers/thinning.hpp"
#include "common/geometry/motion_covariance.hpp"
#include "odometry/degeneracy.hpp"

namespace zloam::odometry {
namespace {

// Residuals above this many kernel widths are left out.
constexpr double kGateWidths = 3.0;
// While the kernel is still wide, every kCoarseStride-th point suffices: these steps only have to
// come near the solution.
constexpr std::size_t kCoarseStride = 4;
constexpr std::size_t kLeastForCoarse = 1000;
// Number of points that suffices to compare starts with different angular rates.
constexpr std::size_t kPointsToCompare = 500;

std::uint16_t bin_of(const Point& point, const FeatureSweep& sweep) {
  if (sweep.deskewed || sweep.period_ns == 0) {
    return kTimeBins;  // the sweep's end
  }
  const double turn = static_cast<double>(point.time_ns) / sweep.period_ns;
  return static_cast<std::uint16_t>(std::lround(std::min(turn, 1.0) * kTimeBins));
}

void append(PointSpan points, const Thinning& thinning, const FeatureSweep& sweep,
            const Pose& T_base_lidar, std::vector<SourcePoint>& out) {
  thinning.each(points, [&](const Point& p) {
    if (!is_usable(p)) return;
    out.push_back({T_base_lidar * p.position().cast<double>(), bin_of(p, sweep)});
  });
}

void sort_by_time(std::vector<SourcePoint>& points) {
  // Stable: the order of sums, and so the last bits, depends on the input alone.
  std::stable_sort(points.begin(), points.end(),
                   [](const SourcePoint& a, const SourcePoint& b) { return a.bin < b.bin; });
}

class Association {
 public:
  Association(const OdometryConfig& config, double range_noise_m, WindowMap& recent)
      : recent_(recent) {
    const double variance = std::max(1e-4, range_noise_m) * std::max(1e-4, range_noise_m);
    plane_weight_ = 1.0 / (variance * std::max(1.0, config.correlation));
  }

  void run(const Source& source, const MotionState& state, const MotionTable& table, double gate_m,
           std::size_t stride, Residuals& out) {
    out.planes.clear();
    hints_.resize(source.planes.size());
    positions_.clear();
    for (std::size_t i = 0; i < source.planes.size(); i += stride) {
      const SourcePoint& p = source.planes[i];
      positions_.push_back(state.T_odom_mid * (table[p.bin] * p.position));
    }
    recent_.find(positions_, hints_, stride);
    for (std::size_t k = 0; k < positions_.size(); ++k) {
      const std::size_t i = k * stride;
      add_plane(source.planes[i], positions_[k], gate_m, hints_[i], out);
    }
  }

  double cost_of_unmatched(const Source& source, const Residuals& matched, std::size_t stride,
                           double kernel_m) const {
    const double planes = static_cast<double>(source.planes.size()) / static_cast<double>(stride) -
                          static_cast<double>(matched.planes.size());
    return 0.5 * plane_weight_ * kernel_m * kernel_m * planes;
  }

 private:
  void add_plane(const SourcePoint& p, const Eigen::Vector3d& w, double gate_m,
                 const WindowMap::Hint& hint, Residuals& out) {
    const FittedPlane* plane = hint.plane;
    if (plane == nullptr) return;
    if (std::abs(plane->normal.dot(w) - plane->offset) < gate_m) {
      out.planes.push_back({p.position, plane->normal, plane->offset, plane_weight_, p.bin});
    }
  }

  WindowMap& recent_;
  double plane_weight_;
  std::vector<WindowMap::Hint> hints_;      // of source.planes
  std::vector<Eigen::Vector3d> positions_;  // in odom, of the points that are looked up
};

bool is_small(const Vector12& step, const OdometryConfig& config) {
  return step.head<3>().norm() < config.stop_translation_m &&
         step.segment<3>(6).norm() < config.stop_translation_m &&
         step.segment<3>(3).norm() < config.stop_rotation_rad &&
         step.segment<3>(9).norm() < config.stop_rotation_rad;
}

}  // namespace

bool is_usable(const Point& point) {
  constexpr float kFarthest2 = 1e8F;  // 10 km
  // Written so that NaN fails.
  return point.position().squaredNorm() < kFarthest2;
}

bool any_usable(PointSpan points) {
  return std::any_of(points.begin(), points.end(), [](const Point& p) { return is_usable(p); });
}

bool Source::sees_a_part() const {
  return !planes.empty() && zloam::sees_a_part(fraction_of_bin(planes.front().bin),
                                               fraction_of_bin(planes.back().bin));
}

Source choose_source(const FeatureSweep& sweep, const Pose& T_base_lidar,
                     const OdometryConfig& config) {
  Source source;
  const auto wanted = static_cast<std::size_t>(std::max(1, config.max_matched_points));
  const std::size_t n = sweep.less_flat.size();
  const std::size_t stride = std::max<std::size_t>(1, (n + wanted - 1) / wanted);
  append(sweep.less_flat, {stride, sweep.sweep}, sweep, T_base_lidar, source.planes);
  sort_by_time(source.planes);
  return source;
}

std::vector<MotionState> likeliest(const Source& source, const std::vector<MotionState>& starts,
                                   std::size_t most, const MotionPrior& prior, double range_noise_m,
                                   const OdometryConfig& config, WindowMap& recent) {
  const double kernel_m = std::max(config.kernel_m, config.kernel_start_m);
  const std::size_t stride = stride_to(kPointsToCompare, source.planes.size());
  Association association(config, range_noise_m, recent);
  Residuals residuals;
  std::vector<std::pair<double, std::size_t>> costs;
  for (const MotionState& state : starts) {
    const MotionTable table(state);
    association.run(source, state, table, kGateWidths * kernel_m, stride, residuals);
    NormalEquations sums;
    add_residuals(state, table, residuals, kernel_m, false, sums);
    add_prior(state, prior, sums);
    costs.emplace_back(
        sums.cost + association.cost_of_unmatched(source, residuals, stride, kernel_m),
        costs.size());
  }
  std::sort(costs.begin(), costs.end());
  std::vector<MotionState> best;
  for (std::size_t i = 0; i < std::min(most, costs.size()); ++i) {
    best.push_back(starts[costs[i].second]);
  }
  return best;
}

Solution match_sweep(const Source& source, const MotionState& initial, const MotionPrior& prior,
                     double range_noise_m, const OdometryConfig& config, WindowMap& recent) {
  Solution out;
  out.state = initial;
  Residuals residuals;
  Association association(config, range_noise_m, recent);
  double kernel_m = std::max(config.kernel_m, config.kernel_start_m);
  const bool many = source.planes.size() > kLeastForCoarse;
  const bool with_bend = prior.bend_sigma.minCoeff() > 0.0;
  for (int i = 0; i < config.max_iterations; ++i) {
    const MotionTable table(out.state);
    const std::size_t stride = kernel_m > config.kernel_m && many ? kCoarseStride : 1;
    association.run(source, out.state, table, kGateWidths * kernel_m, stride, residuals);
    out.planes = static_cast<std::uint32_t>(stride * residuals.planes.size());
    out.solved = out.planes >= static_cast<std::uint32_t>(config.min_correspondences);
    if (!out.solved) {
      out.state = initial;
      return out;
    }
    out.data = {};
    add_residuals(out.state, table, residuals, kernel_m, with_bend, out.data);
    NormalEquations equations = out.data;
    if (prior.normal_error_rad > 0.0) discount_spurious(prior.normal_error_rad, equations);
    add_prior(out.state, prior, equations);
    const EliminatedBend bend(out.state, prior, equations);
    const double unmatched = association.cost_of_unmatched(source, residuals, stride, kernel_m);
    out.cost = equations.cost + unmatched;
    out.prior_cost = equations.cost - out.data.cost;
    out.fit = (out.data.cost + unmatched) /
              static_cast<double>(std::max<std::size_t>(1, source.planes.size()));
    const Vector12 step = solve_step(equations);
    out.state = moved(out.state, step);
    out.state.bend += bend.step(step);
    out.covariance = equations.H.ldlt().solve(Matrix12::Identity());
    out.iterations = static_cast<std::uint32_t>(i + 1);
    if (kernel_m <= config.kernel_m && is_small(step, config)) {
      out.converged = true;
      break;
    }
    kernel_m = std::max(config.kernel_m, 0.5 * kernel_m);
  }
  if (source.sees_a_part()) out.seen_at = seen_at(out.data.H);
  out.residual_m = std::sqrt(out.data.squared_sum / std::max(1e-9, out.data.weight_sum));
  out.state.T_odom_mid = normalised(out.state.T_odom_mid);
  out.solved = out.state.T_odom_mid.matrix().allFinite() && out.state.twist.allFinite();
  if (!out.solved) {
    out.state = initial;
  }
  return out;
}

}  // namespace zloam::odometry
