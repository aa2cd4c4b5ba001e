#include "simulator/terrain.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "simulator/random.hpp"

namespace zloam::simulator {
namespace {

// A sum of plane waves of random direction, length and phase; its amplitude stays below 1.
class Waves {
 public:
  Waves(Random& random, double shortest_m, double longest_m) {
    for (Wave& wave : waves_) {
      const double direction = random.uniform(0.0, 2.0 * std::numbers::pi);
      const double number = 2.0 * std::numbers::pi / random.uniform(shortest_m, longest_m);
      wave = {number * std::cos(direction), number * std::sin(direction),
              random.uniform(0.0, 2.0 * std::numbers::pi)};
    }
  }
  double at(double x, double y) const {
    double sum = 0.0;
    for (const Wave& wave : waves_) {
      sum += std::sin(wave.kx * x + wave.ky * y + wave.phase);
    }
    return sum / static_cast<double>(std::size(waves_));
  }

 private:
  struct Wave {
    double kx, ky, phase;
  };
  Wave waves_[5];
};

}  // namespace

Terrain::Terrain(const Eigen::Vector2d& low, const Eigen::Vector2d& high, double spacing_m,
                 const TerrainShape& shape, std::uint64_t seed)
    : low_(low),
      spacing_(spacing_m),
      columns_(static_cast<std::size_t>(std::ceil((high.x() - low.x()) / spacing_m)) + 1),
      rows_(static_cast<std::size_t>(std::ceil((high.y() - low.y()) / spacing_m)) + 1),
      heights_(columns_ * rows_) {
  Random random(seed, Stream::kTerrain);
  const Waves hills(random, 30.0, 90.0);
  const Waves bumps(random, 4.0, 12.0);
  for (std::size_t row = 0; row < rows_; ++row) {
    for (std::size_t column = 0; column < columns_; ++column) {
      const double x = low.x() + static_cast<double>(column) * spacing_m;
      const double y = low.y() + static_cast<double>(row) * spacing_m;
      heights_[row * columns_ + column] = static_cast<float>(
          shape.long_wave_m * hills.at(x, y) + shape.short_wave_m * bumps.at(x, y) +
          shape.relief_m * random.uniform(-1.0, 1.0));
    }
  }
  measure();
}

void Terrain::measure() {
  highest_ = *std::max_element(heights_.begin(), heights_.end());
  double steepest_x = 0.0;
  double steepest_y = 0.0;
  for (std::size_t row = 0; row + 1 < rows_; ++row) {
    for (std::size_t column = 0; column + 1 < columns_; ++column) {
      const float* h = &heights_[row * columns_ + column];
      steepest_x = std::max({steepest_x, std::abs(double{h[1]} - h[0]),
                             std::abs(double{h[columns_ + 1]} - h[columns_])});
      steepest_y = std::max({steepest_y, std::abs(double{h[columns_]} - h[0]),
                             std::abs(double{h[columns_ + 1]} - h[1])});
    }
  }
  steepest_ = std::hypot(steepest_x, steepest_y) / spacing_;
}

Terrain::Local Terrain::local(double x, double y) const {
  const double gx =
      std::clamp((x - low_.x()) / spacing_, 0.0, static_cast<double>(columns_ - 1) - 1e-9);
  const double gy =
      std::clamp((y - low_.y()) / spacing_, 0.0, static_cast<double>(rows_ - 1) - 1e-9);
  const auto column = static_cast<std::size_t>(gx);
  const auto row = static_cast<std::size_t>(gy);
  const double u = gx - static_cast<double>(column);
  const double v = gy - static_cast<double>(row);
  const float* h = &heights_[row * columns_ + column];
  const double a = h[0];
  const double b = h[1];
  const double c = h[columns_];
  const double d = h[columns_ + 1];
  const double near_edge = a + u * (b - a);
  const double far_edge = c + u * (d - c);
  return {near_edge + v * (far_edge - near_edge),
          {((b - a) + v * ((d - c) - (b - a))) / spacing_, (far_edge - near_edge) / spacing_}};
}

double Terrain::height(double x, double y) const { return local(x, y).height; }

bool Terrain::covers(double x, double y) const {
  return x >= low_.x() && y >= low_.y() &&
         x <= low_.x() + spacing_ * static_cast<double>(columns_ - 1) &&
         y <= low_.y() + spacing_ * static_cast<double>(rows_ - 1);
}

std::optional<Crossing> Terrain::cross(const Ray& ray, double max_range_m) const {
  constexpr int kMaxSteps = 600;
  constexpr double kCloseM = 2e-3;
  constexpr double kExactM = 1e-7;
  const Eigen::Vector3d& d = ray.direction;
  const double closing = steepest_ * d.head<2>().norm() - d.z();
  if (closing <= 1e-9 || (d.z() >= 0.0 && ray.origin.z() > highest_)) {
    return std::nullopt;
  }
  double t = kNearestHitM;
  if (ray.origin.z() > highest_) {
    t = std::max(t, (highest_ - ray.origin.z()) / d.z());
  }
  for (int step = 0; step < kMaxSteps && t < max_range_m; ++step) {
    const Eigen::Vector3d p = ray.origin + t * d;
    if (!covers(p.x(), p.y())) {
      return std::nullopt;
    }
    const Local ground = local(p.x(), p.y());
    const double above = p.z() - ground.height;
    const double rate = ground.slope.dot(d.head<2>()) - d.z();  // height lost per metre of range
    if (std::abs(above) < kExactM) {
      return Crossing{t, std::max(rate, 0.0) / std::sqrt(1.0 + ground.slope.squaredNorm())};
    }
    if (above < 0.0 && above < -kCloseM) {
      return std::nullopt;  // started below the ground
    }
    // Near the surface Newton's step is nearly exact within one cell, whose curvature is small.
    t += above < kCloseM && rate > 0.1 * closing ? above / rate : above / closing;
  }
  return std::nullopt;
}

}  // namespace zloam::simulator
