#include "ros/cdr.hpp"

#include <array>
#include <cmath>
#include <cstddef>

#include "common/geometry/imu_limits.hpp"
#include "ros/cdr_stream.hpp"

namespace zloam::ros {
namespace {

CdrWriter& operator<<(CdrWriter& out, const Stamped& header) {
  // Nanoseconds must not be negative, also for times before 1970.
  constexpr std::int64_t kSecond = 1'000'000'000;
  const std::int64_t ns = (header.stamp_ns % kSecond + kSecond) % kSecond;
  const auto seconds = static_cast<std::int32_t>((header.stamp_ns - ns) / kSecond);
  return out << seconds << static_cast<std::uint32_t>(ns) << std::string_view(header.frame);
}
CdrWriter& operator<<(CdrWriter& out, const Eigen::Vector3d& v) {
  return out << v.x() << v.y() << v.z();
}
CdrWriter& operator<<(CdrWriter& out, const Pose& pose) {
  const Eigen::Quaterniond q(pose.linear());
  return out << Eigen::Vector3d(pose.translation()) << q.x() << q.y() << q.z() << q.w();
}
CdrWriter& operator<<(CdrWriter& out, const Matrix6& covariance) {
  for (int i = 0; i < 36; ++i) out << covariance(i / 6, i % 6);
  return out;
}

void field(CdrWriter& out, const char* name, std::uint32_t offset) {
  constexpr std::uint8_t kFloat32 = 7;
  out << std::string_view(name) << offset << kFloat32 << std::uint32_t{1};
}

template <class Numbers>
void read_into(CdrReader& in, Numbers& numbers) {
  for (double& number : numbers) in >> number;
}

/// A name of a frame that is longer is none.
constexpr std::size_t kLongestFrame = 255;

/// False for NaN too.
bool is_plausible(const Eigen::Vector3d& v) { return (v.array().abs() <= kMostOfReading).all(); }

/// ROS marks a quantity without measurement by -1 as the first element of its covariance.
bool is_measured(const std::array<double, 9>& covariance) { return covariance[0] != -1.0; }

}  // namespace

Cdr encode(const OdometryMessage& m) {
  CdrWriter out(1024);
  out << m.header << std::string_view(m.child_frame) << m.T_frame_child << m.pose_covariance;
  out << Eigen::Vector3d(m.twist.head<3>()) << Eigen::Vector3d(m.twist.tail<3>());
  out << m.twist_covariance;
  return out.take();
}

Cdr encode(const PoseMessage& m) {
  CdrWriter out(512);
  out << m.header << m.T_frame_base << m.covariance;
  return out.take();
}

Cdr encode(const std::vector<TransformMessage>& message) {
  CdrWriter out(512);
  out.count(message.size());
  for (const TransformMessage& m : message)
    out << m.header << std::string_view(m.child_frame) << m.T_frame_child;
  return out.take();
}

Cdr encode(const PathMessage& m) {
  CdrWriter out(128 + m.poses.size() * (80 + m.header.frame.size()));
  out << m.header;
  out.count(m.poses.size());
  for (const auto& [stamp_ns, pose] : m.poses) out << Stamped{stamp_ns, m.header.frame} << pose;
  return out.take();
}

Cdr encode(const CloudMessage& m) {
  static_assert(sizeof(MapPoint) == 16 && offsetof(MapPoint, intensity) == 12);
  const auto count = static_cast<std::uint32_t>(m.points.size());
  const auto step = static_cast<std::uint32_t>(sizeof(MapPoint));
  CdrWriter out(256 + m.points.size_bytes());
  out << m.header << std::uint32_t{1} << count;
  out.count(4);
  field(out, "x", 0);
  field(out, "y", 4);
  field(out, "z", 8);
  field(out, "intensity", 12);
  constexpr bool kBigEndian = false, kDense = true;
  out << kBigEndian << step << step * count;
  out.octets(m.points.data(), m.points.size_bytes());
  out << kDense;
  return out.take();
}

Cdr encode(const DiagnosticsMessage& m) {
  CdrWriter out(1024);
  out << m.header;
  out.count(m.all.size());
  for (const Diagnostic& each : m.all) {
    out << static_cast<std::uint8_t>(each.level) << std::string_view(each.name)
        << std::string_view(each.message) << std::string_view(each.hardware);
    out.count(each.values.size());
    for (const auto& [key, value] : each.values)
      out << std::string_view(key) << std::string_view(value);
  }
  return out.take();
}

std::optional<ImuReading> decode_imu(std::span<const std::uint8_t> bytes) {
  CdrReader in(bytes);
  std::int32_t seconds = 0;
  std::uint32_t nanoseconds = 0;
  std::string frame;
  std::array<double, 4> orientation{};
  std::array<double, 9> of_orientation{}, of_rate{}, of_force{};
  ImuReading reading;
  in >> seconds >> nanoseconds >> frame;
  read_into(in, orientation);
  read_into(in, of_orientation);
  read_into(in, reading.rate_radps);
  read_into(in, of_rate);
  read_into(in, reading.force_mps2);
  read_into(in, of_force);
  if (!in.ok() || !is_measured(of_rate) || !is_measured(of_force)) return std::nullopt;
  if (!is_plausible(reading.rate_radps) || !is_plausible(reading.force_mps2)) return std::nullopt;
  if (seconds < 0 || nanoseconds >= 1'000'000'000U) return std::nullopt;
  reading.stamp_ns = std::int64_t{seconds} * 1'000'000'000 + nanoseconds;
  return reading;
}

std::optional<PlaceMessage> decode_place(std::span<const std::uint8_t> bytes) {
  CdrReader in(bytes);
  std::int32_t seconds = 0;
  std::uint32_t nanoseconds = 0;
  PlaceMessage place;
  std::array<double, 3> position{};
  std::array<double, 4> xyzw{};
  std::array<double, 36> covariance{};
  in >> seconds >> nanoseconds >> place.frame;
  read_into(in, position);
  read_into(in, xyzw);
  read_into(in, covariance);
  const auto [x, y, z, w] = xyzw;
  const double norm = x * x + y * y + z * z + w * w;
  // The negated comparison also rejects NaN.
  if (!in.ok() || !(std::abs(norm - 1.0) < 0.01)) return std::nullopt;
  if (place.frame.size() > kLongestFrame) return std::nullopt;
  if (!std::isfinite(position[0]) || !std::isfinite(position[1])) return std::nullopt;
  place.x_m = position[0];
  place.y_m = position[1];
  place.yaw_rad = std::atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z));
  return place;
}

}  // namespace zloam::ros
