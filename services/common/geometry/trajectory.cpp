#include "common/geometry/trajectory.hpp"

#include <charconv>
#include <cinttypes>
#include <cstdio>
#include <cstdlib>

namespace zloam {
namespace {

constexpr std::size_t kPiece = 1U << 16;

// In integers, because a double can't hold nanoseconds since 1970.
std::string seconds(std::int64_t ns) {
  constexpr std::int64_t kSecond = 1'000'000'000;
  char text[48];
  std::snprintf(text, sizeof text, "%s%" PRId64 ".%09" PRId64, ns < 0 ? "-" : "",
                std::abs(ns / kSecond), std::abs(ns % kSecond));
  return text;
}

void append(std::string& text, double value) {
  // Room for the greatest double with nine decimals.
  char number[330];
  const auto [end, error] = std::to_chars(number, number + sizeof number,
                                          value == 0.0 ? 0.0 : value, std::chars_format::fixed, 9);
  text += ' ';
  text.append(number, error == std::errc() ? end : number);
}

}  // namespace

std::string tum_line(const TrajectoryPose& pose) {
  Eigen::Quaterniond q(pose.T_parent_base.linear());
  q.normalize();
  if (q.w() < 0.0) q.coeffs() = -q.coeffs();
  std::string line = seconds(pose.instant_ns);
  for (int i = 0; i < 3; ++i) append(line, pose.T_parent_base.translation()[i]);
  for (const double c : {q.x(), q.y(), q.z(), q.w()}) append(line, c);
  return line + '\n';
}

std::string kitti_line(const TrajectoryPose& pose) {
  std::string line;
  for (int row = 0; row < 3; ++row) {
    for (int column = 0; column < 4; ++column) append(line, pose.T_parent_base(row, column));
  }
  return line.substr(1) + '\n';
}

std::string_view TrajectoryText::next() {
  piece_.clear();
  for (; done_ < poses_.size() && piece_.size() < kPiece; ++done_) piece_ += line_(poses_[done_]);
  return piece_;
}

}  // namespace zloam
