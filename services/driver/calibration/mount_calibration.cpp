#include "driver/calibration/mount_calibration.hpp"

#include <ceres/ceres.h>

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <map>
#include <stdexcept>
#include <tuple>
#include <utility>

namespace zloam::driver::calibration {
namespace {

constexpr std::size_t kUnknowns = 5;
// Pitch and yaw, degrees, and y and z, m, that correct the initial mount, in a frame whose x lies
// along the motor's axis; delay, ms.
using Vector = std::array<double, kUnknowns>;

constexpr std::size_t kMostPoints = 60'000;
constexpr std::size_t kLeastInVoxel = 30;
// An unknown counts as determined if its standard deviation is below: 0.05 degrees, 5 mm, 1 ms.
constexpr Vector kAsked = {0.05, 0.05, 0.005, 0.005, 1.0};
// If a smaller share of the points lies on planes, the platform has probably moved.
constexpr double kLeastFlat = 0.3;
// Delays tried before the first solution, up to 40 ms to either side: at 180 degrees per second,
// the greatest of them changes the angle by seven degrees.
constexpr int kDelaySteps = 10;  // to either side
constexpr double kDelayStep_ms = 4.0;

/// Stages from coarse to fine: edge of the voxels, greatest thickness of a plane in a voxel, number
/// of solutions, whether patches of one surface are joined.
struct Stage {
  double edge_m, thick_m;
  int rounds;
  bool whole;
};
constexpr std::array kStages = {Stage{2.0, 0.25, 3, false}, Stage{1.5, 0.1, 3, false},
                                Stage{1.0, 0.05, 3, false}, Stage{1.0, 0.05, 5, true}};

/// One return, placed by the initial mount, in a frame whose x lies along the motor's axis.
struct Ray {
  Eigen::Vector3d point;
  std::int64_t at_ns;
};

class Points {
 public:
  Points(const Recording& recording, spinning::Mount start)
      : recording_(recording), start_(std::move(start)) {
    R_lidar_across_.linear() =
        Eigen::Quaterniond::FromTwoVectors(Eigen::Vector3d::UnitX(), start_.axis)
            .toRotationMatrix();
    std::size_t echoes = 0;
    for (const scip::TimedScan& line : recording.lines) echoes += line.scan.echoes.size();
    const std::size_t stride = std::max<std::size_t>(1, echoes / kMostPoints);
    std::size_t i = 0;
    for (const scip::TimedScan& line : recording.lines) {
      for (const scip::Echo& echo : line.scan.echoes) {
        if (i++ % stride == 0) add(line, echo);
      }
    }
  }

  std::size_t size() const { return rays_.size(); }

  /// Position of a return with these unknowns. False if the motor's angle is not known.
  bool at(std::size_t i, const Vector& x, Eigen::Vector3d& p) const {
    const Ray& ray = rays_[i];
    const auto delay_ns = static_cast<std::int64_t>(std::llround(1e6 * x[4]));
    double before = 0.0, after = 0.0;
    // Interpolated between whole nanoseconds, so that the position is differentiable by the delay.
    const double rest_ns = 1e6 * x[4] - static_cast<double>(delay_ns);
    constexpr std::int64_t kSpan_ns = 500'000;
    const std::int64_t at_ns = ray.at_ns + delay_ns;
    if (recording_.angles.at(at_ns - kSpan_ns, before) != spinning::Angle::kKnown ||
        recording_.angles.at(at_ns + kSpan_ns, after) != spinning::Angle::kKnown) {
      return false;
    }
    const double part = 0.5 + 0.5 * rest_ns / static_cast<double>(kSpan_ns);
    const double angle_rad = before + part * (after - before);
    p = spinning::turned(start_, angle_rad, R_lidar_across_ * (correction(x) * ray.point));
    return true;
  }

  /// T_motor_scanner with these unknowns: corrections across the axis to the initial one.
  Pose mounted(const Vector& x) const {
    return R_lidar_across_ * correction(x) * R_lidar_across_.inverse() * start_.T_motor_scanner;
  }

 private:
  static Pose correction(const Vector& x) {
    return pose_from_xyz_rpy_deg({0.0, x[2], x[3]}, {0.0, x[0], x[1]});
  }

  void add(const scip::TimedScan& line, const scip::Echo& echo) {
    const scip::Parameters& scanner = recording_.scanner;
    if (const auto point = spinning::in_scanner(scanner, echo)) {
      const Eigen::Vector3d in_motor = start_.T_motor_scanner * *point;
      const std::int64_t at_ns = line.stamp_ns + scanner.step_ns(echo.step);
      rays_.push_back({R_lidar_across_.inverse() * in_motor, at_ns});
    }
  }

  const Recording& recording_;
  spinning::Mount start_;
  /// from a frame whose x lies along the motor's axis
  Pose R_lidar_across_ = Pose::Identity();
  std::vector<Ray> rays_;
};

struct Plane {
  Eigen::Vector3d centre, normal;
  double thickness_m;
};

Plane plane_of(const std::vector<Eigen::Vector3d>& points) {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (const Eigen::Vector3d& p : points) sum += p;
  const Eigen::Vector3d centre = sum / static_cast<double>(points.size());
  Eigen::Matrix3d moments = Eigen::Matrix3d::Zero();
  for (const Eigen::Vector3d& p : points) moments += (p - centre) * (p - centre).transpose();
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> axes(moments);
  const double variance = axes.eigenvalues()[0] / static_cast<double>(points.size());
  return {centre, axes.eigenvectors().col(0), std::sqrt(std::max(0.0, variance))};
}

/// Indices of the returns of one voxel that lie on a plane.
using Patch = std::vector<std::size_t>;

std::vector<Eigen::Vector3d> placed(const Points& points, const Patch& patch, const Vector& x) {
  std::vector<Eigen::Vector3d> out(patch.size(), Eigen::Vector3d::Zero());
  for (std::size_t i = 0; i < patch.size(); ++i) points.at(patch[i], x, out[i]);
  return out;
}

std::vector<Patch> patches_of(const Points& points, const Vector& x, const Stage& stage) {
  std::map<std::tuple<int, int, int>, Patch> voxels;
  for (std::size_t i = 0; i < points.size(); ++i) {
    Eigen::Vector3d p;
    if (!points.at(i, x, p)) continue;
    const Eigen::Vector3i cell = (p / stage.edge_m).array().floor().cast<int>();
    voxels[{cell.x(), cell.y(), cell.z()}].push_back(i);
  }
  std::vector<Patch> patches;
  for (const auto& [cell, all] : voxels) {
    if (all.size() < kLeastInVoxel) continue;
    const std::vector<Eigen::Vector3d> where = placed(points, all, x);
    const Plane plane = plane_of(where);
    if (plane.thickness_m > stage.thick_m) continue;
    Patch near;
    for (std::size_t i = 0; i < all.size(); ++i) {
      const double off_m = std::abs(plane.normal.dot(where[i] - plane.centre));
      if (off_m < 3.0 * plane.thickness_m + 0.01) near.push_back(all[i]);
    }
    if (near.size() >= kLeastInVoxel) patches.push_back(std::move(near));
  }
  return patches;
}

// Limits within which patches belong to one wall or floor.
constexpr double kSameTurn = 0.9986;  // cosine of three degrees
constexpr double kSamePlane_m = 0.06;
constexpr double kSameReach_m = 8.0;

/// Joins the patches of one surface: an error of the mount bends a floor as a whole, but hardly a
/// single metre of it.
std::vector<Patch> joined(const Points& points, std::vector<Patch> patches, const Vector& x) {
  std::sort(patches.begin(), patches.end(),
            [](const Patch& a, const Patch& b) { return a.size() > b.size(); });
  std::vector<Patch> whole;
  std::vector<Plane> planes;
  for (const Patch& patch : patches) {
    const Plane plane = plane_of(placed(points, patch, x));
    const auto same = std::find_if(planes.begin(), planes.end(), [&](const Plane& other) {
      const Eigen::Vector3d apart = plane.centre - other.centre;
      return std::abs(plane.normal.dot(other.normal)) > kSameTurn &&
             std::abs(other.normal.dot(apart)) < kSamePlane_m && apart.norm() < kSameReach_m;
    });
    if (same == planes.end()) {
      whole.push_back(patch);
      planes.push_back(plane);
    } else {
      Patch& of = whole[static_cast<std::size_t>(same - planes.begin())];
      of.insert(of.end(), patch.begin(), patch.end());
    }
  }
  return whole;
}

double thickness_m(const Points& points, const std::vector<Patch>& patches, const Vector& x) {
  double squares = 0.0, count = 0.0;
  for (const Patch& patch : patches) {
    const double off_m = plane_of(placed(points, patch, x)).thickness_m;
    squares += static_cast<double>(patch.size()) * off_m * off_m;
    count += static_cast<double>(patch.size());
  }
  return std::sqrt(squares / std::max(1.0, count));
}

struct OffPlane {
  const Points& points;
  const Patch& patch;

  bool operator()(double const* const* parameters, double* residuals) const {
    Vector x{};
    std::copy_n(parameters[0], kUnknowns, x.begin());
    const std::vector<Eigen::Vector3d> where = placed(points, patch, x);
    const Plane plane = plane_of(where);
    for (std::size_t i = 0; i < where.size(); ++i) {
      residuals[i] = plane.normal.dot(where[i] - plane.centre);
    }
    return true;
  }
};

struct Solved {
  Vector x{};
  Vector sigma{};
  bool converged = false;
};

// Greatest distance from the initial values. No mount is off by more, and farther away are
// degenerate solutions in which all points coincide.
constexpr Vector kFarthest = {10.0, 10.0, 0.3, 0.3, 100.0};

using Matrix = Eigen::Matrix<double, kUnknowns, kUnknowns>;
using Column = Eigen::Matrix<double, kUnknowns, 1>;

/// Contribution of one surface at the solution.
struct Witness {
  Matrix information = Matrix::Zero();
  Column pull = Column::Zero();  ///< its part of the gradient; the sum over all surfaces is zero
};

struct Witnesses {
  std::vector<Witness> each;
  Matrix information = Matrix::Zero();
  double variance_m2 = 0.0;
};

Witnesses witnesses_of(ceres::Problem& problem) {
  Witnesses all;
  double squares = 0.0, count = 0.0;
  std::vector<ceres::ResidualBlockId> blocks;
  problem.GetResidualBlocks(&blocks);
  for (ceres::ResidualBlockId block : blocks) {
    ceres::Problem::EvaluateOptions one;
    one.residual_blocks = {block};
    double cost = 0.0;
    std::vector<double> residuals, gradient;
    ceres::CRSMatrix jacobian;
    problem.Evaluate(one, &cost, &residuals, &gradient, &jacobian);
    const auto rows = static_cast<Eigen::Index>(residuals.size());
    const Eigen::Map<const Eigen::Matrix<double, Eigen::Dynamic, kUnknowns, Eigen::RowMajor>> J(
        jacobian.values.data(), rows, kUnknowns);
    all.each.push_back({J.transpose() * J, Eigen::Map<const Column>(gradient.data())});
    all.information += all.each.back().information;
    squares += 2.0 * cost;
    count += static_cast<double>(rows);
  }
  all.variance_m2 = squares / std::max(1.0, count);
  return all;
}

bool tells_all(const Matrix& information) {
  constexpr double kLeastInformation = 1e-9;
  return Eigen::SelfAdjointEigenSolver<Matrix>(information).eigenvalues()[0] > kLeastInformation;
}

/// Standard deviation of each unknown. Deviations of a surface from a plane are correlated over all
/// of its points, so each surface counts as one observation: the solutions without each of them
/// give the uncertainty (jackknife over clusters; MacKinnon and White 1985). At least the
/// uncertainty by the noise of the points.
Vector sigmas_of(ceres::Problem& problem) {
  const Witnesses all = witnesses_of(problem);
  Vector sigma;
  sigma.fill(1e3);
  if (!tells_all(all.information)) return sigma;
  Matrix by_surface = Matrix::Zero();
  for (const Witness& witness : all.each) {
    const Matrix others = all.information - witness.information;
    if (!tells_all(others)) return sigma;
    const Column moved = others.ldlt().solve(witness.pull);
    by_surface += moved * moved.transpose();
  }
  const Matrix by_noise = all.variance_m2 * all.information.inverse();
  for (std::size_t i = 0; i < kUnknowns; ++i) {
    const auto k = static_cast<Eigen::Index>(i);
    sigma[i] = std::sqrt(std::max(by_noise(k, k), by_surface(k, k)));
  }
  return sigma;
}

Solved solve(const Points& points, const std::vector<Patch>& patches, const Vector& start,
             const Vector& around) {
  Solved out{start, {}, false};
  ceres::Problem problem;
  for (const Patch& patch : patches) {
    auto* cost = new ceres::DynamicNumericDiffCostFunction<OffPlane>(new OffPlane{points, patch});
    cost->AddParameterBlock(static_cast<int>(kUnknowns));
    cost->SetNumResiduals(static_cast<int>(patch.size()));
    problem.AddResidualBlock(cost, nullptr, out.x.data());
  }
  for (std::size_t i = 0; i < kUnknowns; ++i) {
    const auto index = static_cast<int>(i);
    problem.SetParameterLowerBound(out.x.data(), index, around[i] - kFarthest[i]);
    problem.SetParameterUpperBound(out.x.data(), index, around[i] + kFarthest[i]);
  }
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_NORMAL_CHOLESKY;
  options.max_num_iterations = 15;
  options.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  out.converged = summary.IsSolutionUsable();
  out.sigma = sigmas_of(problem);
  return out;
}

/// Searches the delay with which most returns lie on planes; the other unknowns have less
/// influence.
Vector with_best_delay(const Points& points, Vector x) {
  const double known_ms = x[4];
  std::pair<double, double> best{-1.0, known_ms};
  for (int step = -kDelaySteps; step <= kDelaySteps; ++step) {
    x[4] = known_ms + step * kDelayStep_ms;
    double flat = 0.0;
    for (const Patch& patch : patches_of(points, x, kStages.back())) {
      flat += static_cast<double>(patch.size());
    }
    best = std::max(best, std::pair{flat, x[4]});
  }
  x[4] = best.second;
  return x;
}

std::string objection_to(const MountCalibration& found) {
  if (found.planes == 0) return "no flat surface was seen";
  if (found.flat_share < kLeastFlat) {
    return "what was seen does not become flat: did the platform move, or do the angles belong to "
           "another recording?";
  }
  constexpr std::array names = {"pitch", "yaw", "y", "z", "delay"};
  std::string missing;
  const auto unknowns = found.unknowns();
  for (std::size_t i = 0; i < kUnknowns; ++i) {
    if (!unknowns[i]->found) missing += (missing.empty() ? "" : ", ") + std::string(names[i]);
  }
  if (missing.empty()) return {};
  return "the recording does not tell " + missing +
         " (in a frame whose x lies along motor.axis): take one of a minute, where walls, floor "
         "and ceiling are near; --mount names a file with the motor's axis and the scanner's "
         "nominal pose";
}

}  // namespace

MountCalibration calibrate(const Recording& recording, const spinning::Mount& start) {
  if (recording.lines.empty()) throw std::invalid_argument("there is no line in the recording");
  if (recording.angles.received() == 0) throw std::invalid_argument("there is no angle");
  const Points points(recording, start);
  const Vector known = {0.0, 0.0, 0.0, 0.0, 1e-6 * static_cast<double>(start.angle_delay_ns)};
  MountCalibration out;
  out.before_m = thickness_m(points, patches_of(points, known, kStages.front()), known);
  Solved solved{with_best_delay(points, known), {}, false};
  std::vector<Patch> patches;
  for (const Stage& stage : kStages) {
    for (int round = 0; round < stage.rounds; ++round) {
      patches = patches_of(points, solved.x, stage);
      if (patches.empty()) break;
      if (stage.whole) patches = joined(points, std::move(patches), solved.x);
      solved = solve(points, patches, solved.x, known);
    }
  }
  out.planes = patches.size();
  for (const Patch& patch : patches) out.points += patch.size();
  out.flat_share = static_cast<double>(out.points) /
                   static_cast<double>(std::max<std::size_t>(1, points.size()));
  out.after_m = thickness_m(points, patches, solved.x);
  const auto unknown = [&](std::size_t i) {
    const bool inside = std::abs(solved.x[i] - known[i]) < 0.99 * kFarthest[i];
    const bool found = solved.converged && inside && solved.sigma[i] < kAsked[i];
    return Unknown{solved.x[i], solved.sigma[i], found};
  };
  out.pitch_deg = unknown(0);
  out.yaw_deg = unknown(1);
  out.y_m = unknown(2);
  out.z_m = unknown(3);
  out.delay_ms = unknown(4);
  out.mount = start;
  out.mount.T_motor_scanner = points.mounted(solved.x);
  out.mount.angle_delay_ns = std::llround(1e6 * solved.x[4]);
  out.objection = objection_to(out);
  return out;
}

}  // namespace zloam::driver::calibration
