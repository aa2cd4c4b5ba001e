#pragma once
// A place seen along gravity: an image whose brightness is the number of heights at which a cell
// holds a point, walls bright and ground dark, and its corners with descriptors that do not depend
// on the heading. Method: Gupta et al., "Effectively Detecting Loop Closures using Point Cloud
// Density Maps", ICRA 2024 (ORB on density images), with heights instead of densities: the number
// of hits in a cell says more about the sensor than about the place.

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <vector>

#include "graph/config.hpp"

namespace zloam::graph {

/// Square, rows along y, columns along x, both ascending; the middle is the origin.
struct PlaceImage {
  int edge = 0;
  double cell_m = 0.0;
  std::vector<std::uint8_t> pixels;

  std::uint8_t at(int x, int y) const {
    return pixels[static_cast<std::size_t>(y) * static_cast<std::size_t>(edge) +
                  static_cast<std::size_t>(x)];
  }
};

struct PlaceFeatures {
  /// m from the origin
  std::vector<Eigen::Vector2d> at_m;
  /// direction of each corner, rad
  std::vector<double> heading_rad;
  /// 32 bytes per corner
  std::vector<std::uint8_t> descriptors;
};

/// points: origin at the place, z along gravity.
PlaceImage place_image(std::span<const Eigen::Vector3f> points, const PlaceConfig& config);

PlaceFeatures place_features(const PlaceImage& image, const PlaceConfig& config);

/// Pose of a place relative to another: p_a = R(yaw) p_b + shift.
struct PlaceMatch {
  double yaw_rad = 0.0;
  Eigen::Vector2d shift_m = Eigen::Vector2d::Zero();
  /// corners that agree with it
  std::size_t agreeing = 0;
};

/// The best match; agreeing is 0 where too few corners agree with any.
PlaceMatch match_places(const PlaceFeatures& a, const PlaceFeatures& b, const PlaceConfig& config);

}  // namespace zloam::graph
