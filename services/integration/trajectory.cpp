#include "integration/trajectory.hpp"

#include <charconv>
#include <cinttypes>
#include <cstdio>
#include <cstdlib>

namespace zloam::integration {
namespace {

// Bytes of a line, about: asked for once, and given back to the system as one piece.
constexpr std::size_t kTumLine = 120;
constexpr std::size_t kKittiLine = 170;

// Integer digits only: a double holds no nanoseconds since 1970.
std::string seconds(std::int64_t ns) {
  constexpr std::int64_t kSecond = 1'000'000'000;
  char text[48];
  std::snprintf(text, sizeof text, "%s%" PRId64 ".%09" PRId64, ns < 0 ? "-" : "",
                std::abs(ns / kSecond), std::abs(ns % kSecond));
  return text;
}

void append(std::string& text, double value) {
  // The greatest double and its nine decimals.
  char number[330];
  const auto [end, error] = std::to_chars(number, number + sizeof number,
                                          value == 0.0 ? 0.0 : value, std::chars_format::fixed, 9);
  text += ' ';
  text.append(number, error == std::errc() ? end : number);
}

}  // namespace

std::string tum_text(const Trajectory& poses) {
  std::string text;
  text.reserve(poses.size() * kTumLine);
  for (const TrajectoryPose& pose : poses) {
    Eigen::Quaterniond q(pose.T_parent_base.linear());
    q.normalize();
    if (q.w() < 0.0) q.coeffs() = -q.coeffs();
    text += seconds(pose.instant_ns);
    for (int i = 0; i < 3; ++i) append(text, pose.T_parent_base.translation()[i]);
    for (const double c : {q.x(), q.y(), q.z(), q.w()}) append(text, c);
    text += '\n';
  }
  return text;
}

std::string kitti_text(const Trajectory& poses) {
  std::string text;
  text.reserve(poses.size() * kKittiLine);
  for (const TrajectoryPose& pose : poses) {
    std::string line;
    for (int row = 0; row < 3; ++row) {
      for (int column = 0; column < 4; ++column) append(line, pose.T_parent_base(row, column));
    }
    text += line.substr(1) + '\n';
  }
  return text;
}

}  // namespace zloam::integration
