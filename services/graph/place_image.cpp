#include "graph/place_image.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <numbers>
#include <opencv2/core.hpp>
#include <opencv2/features2d.hpp>

namespace zloam::graph {
namespace {

// Number of occupied heights that makes a cell white.
constexpr unsigned kWhite = 12;
constexpr int kPatch = 31, kDescriptor_bytes = 32;
constexpr int kEdge = 12;
constexpr int kFastThreshold = 12;

struct Pair {
  std::size_t a, b;
};

cv::Mat descriptors_of(const PlaceFeatures& features) {
  return {static_cast<int>(features.at_m.size()), kDescriptor_bytes, CV_8UC1,
          const_cast<std::uint8_t*>(features.descriptors.data())};
}

/// Pairs of corners whose descriptors are each other's nearest.
std::vector<Pair> mutual_nearest(const PlaceFeatures& a, const PlaceFeatures& b, int most_bits) {
  std::vector<cv::DMatch> matches;
  const cv::BFMatcher matcher(cv::NORM_HAMMING, true);
  if (!a.at_m.empty() && !b.at_m.empty()) {
    matcher.match(descriptors_of(a), descriptors_of(b), matches);
  }
  std::vector<Pair> pairs;
  for (const cv::DMatch& m : matches) {
    if (m.distance > static_cast<float>(most_bits)) continue;
    pairs.push_back({static_cast<std::size_t>(m.queryIdx), static_cast<std::size_t>(m.trainIdx)});
  }
  return pairs;
}

Eigen::Vector2d turned(const Eigen::Vector2d& p, double yaw_rad) {
  const double c = std::cos(yaw_rad), s = std::sin(yaw_rad);
  return {c * p.x() - s * p.y(), s * p.x() + c * p.y()};
}

std::vector<Pair> agreeing_with(const PlaceMatch& match, const std::vector<Pair>& pairs,
                                const PlaceFeatures& a, const PlaceFeatures& b, double radius_m) {
  std::vector<Pair> out;
  for (const Pair& pair : pairs) {
    const Eigen::Vector2d at = turned(b.at_m[pair.b], match.yaw_rad) + match.shift_m;
    if ((at - a.at_m[pair.a]).squaredNorm() < radius_m * radius_m) out.push_back(pair);
  }
  return out;
}

/// Least squares over the pairs (Umeyama in the plane).
PlaceMatch fitted(const std::vector<Pair>& pairs, const PlaceFeatures& a, const PlaceFeatures& b) {
  Eigen::Vector2d mean_a = Eigen::Vector2d::Zero(), mean_b = Eigen::Vector2d::Zero();
  for (const Pair& pair : pairs) {
    mean_a += a.at_m[pair.a];
    mean_b += b.at_m[pair.b];
  }
  const auto count = static_cast<double>(pairs.size());
  mean_a /= count;
  mean_b /= count;
  double cosine = 0.0, sine = 0.0;
  for (const Pair& pair : pairs) {
    const Eigen::Vector2d p = a.at_m[pair.a] - mean_a, q = b.at_m[pair.b] - mean_b;
    cosine += q.dot(p);
    sine += q.x() * p.y() - q.y() * p.x();
  }
  PlaceMatch match;
  match.yaw_rad = std::atan2(sine, cosine);
  match.shift_m = mean_a - turned(mean_b, match.yaw_rad);
  match.agreeing = pairs.size();
  return match;
}

}  // namespace

PlaceImage place_image(std::span<const Eigen::Vector3f> points, const PlaceConfig& config) {
  PlaceImage image;
  const int half = static_cast<int>(std::lround(config.half_m / config.cell_m));
  image.edge = 2 * half;
  image.cell_m = config.cell_m;
  const auto cells = static_cast<std::size_t>(image.edge) * static_cast<std::size_t>(image.edge);
  std::vector<std::uint64_t> levels(cells, 0);
  // Points more than half of highest_m below the sensor are taken to be below the ground.
  const double lowest_m = -config.highest_m / 2.0;
  for (const Eigen::Vector3f& p : points) {
    const int x = half + static_cast<int>(std::floor(p.x() / config.cell_m));
    const int y = half + static_cast<int>(std::floor(p.y() / config.cell_m));
    const double level = (static_cast<double>(p.z()) - lowest_m) / config.level_m;
    if (x < 0 || y < 0 || x >= image.edge || y >= image.edge) continue;
    if (!(level >= 0.0) || level >= 64.0) continue;
    levels[static_cast<std::size_t>(y) * static_cast<std::size_t>(image.edge) +
           static_cast<std::size_t>(x)] |= std::uint64_t{1} << static_cast<unsigned>(level);
  }
  image.pixels.resize(cells);
  for (std::size_t i = 0; i < cells; ++i) {
    const auto count = static_cast<unsigned>(std::popcount(levels[i]));
    image.pixels[i] = static_cast<std::uint8_t>(std::min(255U, 255U * count / kWhite));
  }
  return image;
}

PlaceFeatures place_features(const PlaceImage& image, const PlaceConfig& config) {
  // One thread, so that the result does not depend on their number.
  cv::setNumThreads(1);
  const cv::Mat picture(image.edge, image.edge, CV_8UC1,
                        const_cast<std::uint8_t*>(image.pixels.data()));
  const auto orb = cv::ORB::create(config.features, 1.2F, 1, kEdge, 0, 2, cv::ORB::HARRIS_SCORE,
                                   kPatch, kFastThreshold);
  std::vector<cv::KeyPoint> corners;
  cv::Mat descriptors;
  orb->detectAndCompute(picture, cv::noArray(), corners, descriptors);
  PlaceFeatures features;
  const double half = image.edge / 2.0;
  for (std::size_t i = 0; i < corners.size(); ++i) {
    const cv::KeyPoint& corner = corners[i];
    features.at_m.emplace_back((corner.pt.x + 0.5 - half) * image.cell_m,
                               (corner.pt.y + 0.5 - half) * image.cell_m);
    features.heading_rad.push_back(corner.angle * std::numbers::pi / 180.0);
    const auto* bits = descriptors.ptr<std::uint8_t>(static_cast<int>(i));
    features.descriptors.insert(features.descriptors.end(), bits, bits + kDescriptor_bytes);
  }
  return features;
}

PlaceMatch match_places(const PlaceFeatures& a, const PlaceFeatures& b, const PlaceConfig& config) {
  const std::vector<Pair> pairs = mutual_nearest(a, b, config.most_different_bits);
  std::vector<Pair> most;
  // Each pair of corners, with their headings, gives a pose of b.
  for (const Pair& pair : pairs) {
    PlaceMatch guess;
    guess.yaw_rad = a.heading_rad[pair.a] - b.heading_rad[pair.b];
    guess.shift_m = a.at_m[pair.a] - turned(b.at_m[pair.b], guess.yaw_rad);
    std::vector<Pair> agreeing = agreeing_with(guess, pairs, a, b, 2.0 * config.agree_m);
    if (agreeing.size() > most.size()) most = std::move(agreeing);
  }
  if (most.size() < 2) return {};
  std::vector<Pair> agreeing = agreeing_with(fitted(most, a, b), pairs, a, b, config.agree_m);
  if (agreeing.size() < config.fewest_agreeing) return {};
  return fitted(agreeing, a, b);
}

}  // namespace zloam::graph
