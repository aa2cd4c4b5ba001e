#pragma once
// A town of walls and posts for tests, and submaps of it from a drive: seen from the true poses,
// with poses reported by a mapping with drift.

#include <cmath>
#include <cstdint>
#include <random>
#include <vector>

#include "common/geometry/submap.hpp"

namespace zloam::graph {

struct Wall {
  Eigen::Vector2d from, to;
  double height_m;
};

class TestTown {
 public:
  explicit TestTown(unsigned seed, double size_m = 160.0) : random_(seed) {
    std::uniform_real_distribution<double> at(-size_m / 2.0, size_m / 2.0), turn(0.0, 3.1416);
    std::uniform_real_distribution<double> length(2.0, 12.0), height(1.0, 7.0);
    const int count = static_cast<int>(size_m * size_m / 160.0);
    for (int i = 0; i < count; ++i) {
      const Eigen::Vector2d p(at(random_), at(random_));
      const double yaw = turn(random_);
      const Eigen::Vector2d along(std::cos(yaw), std::sin(yaw));
      walls_.push_back({p, p + length(random_) * along, height(random_)});
    }
  }
  explicit TestTown(std::vector<Wall> walls) : walls_(std::move(walls)), random_(1) {}

  const std::vector<Wall>& walls() const { return walls_; }

  /// Points within 40 m, with 1 cm of noise; frame of the pose, whose z is 1.5 m above the ground.
  std::vector<MapPoint> seen_from(const Pose& T_world_base) {
    std::normal_distribution<double> noise(0.0, 0.01);
    std::vector<MapPoint> points;
    const Pose T_base_world = T_world_base.inverse();
    const auto add = [&](double x, double y, double z) {
      const Eigen::Vector3d p = T_base_world * Eigen::Vector3d(x, y, z);
      if (p.norm() > 40.0) return;
      points.push_back({static_cast<float>(p.x() + noise(random_)),
                        static_cast<float>(p.y() + noise(random_)),
                        static_cast<float>(p.z() + noise(random_)), 10.0F});
    };
    for (const Wall& wall : walls_) {
      const double length = (wall.to - wall.from).norm();
      for (double s = 0.0; s < length; s += 0.3) {
        const Eigen::Vector2d at = wall.from + s / length * (wall.to - wall.from);
        for (double z = 0.1; z < wall.height_m; z += 0.3) add(at.x(), at.y(), z);
      }
    }
    const Eigen::Vector3d& centre = T_world_base.translation();
    for (double dx = -20.0; dx < 20.0; dx += 0.6) {
      for (double dy = -20.0; dy < 20.0; dy += 0.6) add(centre.x() + dx, centre.y() + dy, 0.0);
    }
    return points;
  }

 private:
  std::vector<Wall> walls_;
  std::mt19937_64 random_;
};

inline Pose pose_at(double x, double y, double yaw_rad) {
  Pose pose = Pose::Identity();
  pose.linear() = Eigen::AngleAxisd(yaw_rad, Eigen::Vector3d::UnitZ()).toRotationMatrix();
  pose.translation() << x, y, 1.5;
  return pose;
}

/// Submaps along true poses 10 m apart; reported with steps that have errors of these sigmas
/// (translation m, heading rad), which are in their covariance.
struct TestDrive {
  std::vector<Pose> truth;
  std::vector<Submap> submaps;
};

inline TestDrive drive(TestTown& town, const std::vector<Pose>& truth, double sigma_m,
                       double sigma_rad, unsigned seed) {
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal;
  TestDrive out{truth, {}};
  Pose told = truth.front();
  for (std::size_t i = 0; i < truth.size(); ++i) {
    Submap submap;
    if (i > 0) {
      Vector6 error = Vector6::Zero();
      error << sigma_m * normal(random), sigma_m * normal(random), 0.0, 0.0, 0.0,
          sigma_rad * normal(random);
      const Pose step = truth[i - 1].inverse() * truth[i];
      told = told * step * exp_se3(error);
      submap.step_m = step.translation().norm();
      submap.before_sweep = 10 * (i - 1);
    }
    submap.first_sweep = 10 * i;
    submap.sweep = 10 * i;
    submap.last_sweep = 10 * i + 9;
    submap.instant_ns = static_cast<std::int64_t>(1 + i) * 1'000'000'000;
    submap.T_map_submap = told;
    submap.step_covariance.diagonal() << sigma_m * sigma_m, sigma_m * sigma_m, 1e-6, 1e-6, 1e-6,
        sigma_rad * sigma_rad;
    submap.range_noise_m = 0.02;
    submap.points = town.seen_from(truth[i]);
    out.submaps.push_back(std::move(submap));
  }
  return out;
}

/// A circle of the radius, driven this often, submaps 10 m apart; every second lap in the other
/// direction if `both_ways`.
inline std::vector<Pose> rounds(double radius_m, int laps, bool both_ways = false) {
  std::vector<Pose> poses;
  const int count = static_cast<int>(2.0 * 3.14159265 * radius_m / 10.0);
  for (int lap = 0; lap < laps; ++lap) {
    const bool back = both_ways && lap % 2 == 1;
    for (int i = 0; i < count; ++i) {
      const double angle = 2.0 * 3.14159265 * (back ? -i : i) / count;
      poses.push_back(pose_at(radius_m * std::cos(angle), radius_m * std::sin(angle),
                              angle + (back ? -1.5708 : 1.5708)));
    }
  }
  return poses;
}

}  // namespace zloam::graph
