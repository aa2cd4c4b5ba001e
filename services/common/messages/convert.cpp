#include "common/messages/convert.hpp"

namespace zloam {
namespace {

template <int N>
std::optional<Eigen::Matrix<double, N, N>> square_of(const flatbuffers::Vector<double>* values) {
  if (values == nullptr || values->size() != N * N) return std::nullopt;
  Eigen::Matrix<double, N, N> result;
  for (int row = 0; row < N; ++row) {
    for (int column = 0; column < N; ++column) {
      result(row, column) = values->Get(static_cast<flatbuffers::uoffset_t>(row * N + column));
    }
  }
  return result;
}

template <int N>
flatbuffers::Offset<flatbuffers::Vector<double>> put_square(
    flatbuffers::FlatBufferBuilder& builder, const Eigen::Matrix<double, N, N>& values) {
  const Eigen::Matrix<double, N, N, Eigen::RowMajor> rows = values;
  return builder.CreateVector(rows.data(), N * N);
}

}  // namespace

// The structs have the same size, alignment and member offsets (asserted in the header), hold plain
// numbers, and the verifier has checked that the vector lies within the message.
PointSpan points_of(const flatbuffers::Vector<const msg::Point*>* vector) {
  if (vector == nullptr) return {};
  return {reinterpret_cast<const Point*>(vector->Data()), vector->size()};
}

std::span<const MapPoint> map_points_of(const flatbuffers::Vector<const msg::MapPoint*>* vector) {
  if (vector == nullptr) return {};
  return {reinterpret_cast<const MapPoint*>(vector->Data()), vector->size()};
}

flatbuffers::Offset<flatbuffers::Vector<const msg::Point*>> put_points(
    flatbuffers::FlatBufferBuilder& builder, PointSpan points) {
  return builder.CreateVectorOfStructs(reinterpret_cast<const msg::Point*>(points.data()),
                                       points.size());
}

flatbuffers::Offset<flatbuffers::Vector<const msg::MapPoint*>> put_points(
    flatbuffers::FlatBufferBuilder& builder, std::span<const MapPoint> points) {
  return builder.CreateVectorOfStructs(reinterpret_cast<const msg::MapPoint*>(points.data()),
                                       points.size());
}

Eigen::Vector3d vector_of(const msg::Vec3& v) { return {v.x(), v.y(), v.z()}; }

Eigen::Vector3d vector_of(const msg::Vec3* v) {
  return v == nullptr ? Eigen::Vector3d::Zero() : vector_of(*v);
}

msg::Vec3 to_message(const Eigen::Vector3d& v) { return {v.x(), v.y(), v.z()}; }

Pose pose_of(const msg::Pose& pose) {
  const msg::Quat& q = pose.rotation();
  const Eigen::Quaterniond rotation(q.w(), q.x(), q.y(), q.z());
  Pose result = Pose::Identity();
  result.linear() = rotation.normalized().toRotationMatrix();
  result.translation() = vector_of(pose.translation());
  return result;
}

Pose pose_of(const msg::Pose* pose) { return pose == nullptr ? Pose::Identity() : pose_of(*pose); }

msg::Pose to_message(const Pose& pose) {
  const Eigen::Quaterniond q = Eigen::Quaterniond(pose.linear()).normalized();
  return {to_message(Eigen::Vector3d(pose.translation())), msg::Quat(q.x(), q.y(), q.z(), q.w())};
}

std::vector<ImuReading> imu_of(const flatbuffers::Vector<const msg::ImuSample*>* samples) {
  std::vector<ImuReading> readings;
  for (const msg::ImuSample& s : structs_of(samples)) {
    readings.push_back(
        {s.stamp_ns(), vector_of(s.linear_acceleration()), vector_of(s.angular_velocity())});
  }
  return readings;
}

msg::ImuSample to_message(const ImuReading& reading) {
  return {reading.stamp_ns, to_message(reading.force_mps2), to_message(reading.rate_radps)};
}

std::optional<InertialStep> inertial_step_of(const msg::OdometryFeatures& message) {
  const auto covariance = square_of<6>(message.inertial_covariance());
  if (!covariance) return std::nullopt;
  InertialStep step;
  step.velocity_change_mps = vector_of(message.inertial_velocity_change());
  step.turn_rad = vector_of(message.inertial_turn());
  step.covariance = *covariance;
  step.at_rest = message.at_rest();
  return step;
}

Vector6 twist_of(const msg::Twist* twist) {
  Vector6 result = Vector6::Zero();
  if (twist != nullptr) {
    result.head<3>() = vector_of(twist->linear());
    result.tail<3>() = vector_of(twist->angular());
  }
  return result;
}

msg::Twist twist_message(const Vector6& twist) {
  return {to_message(Eigen::Vector3d(twist.head<3>())),
          to_message(Eigen::Vector3d(twist.tail<3>()))};
}

Matrix6 covariance_of(const flatbuffers::Vector<double>* values) {
  return square_of<6>(values).value_or(Matrix6::Zero());
}

flatbuffers::Offset<flatbuffers::Vector<double>> put_covariance(
    flatbuffers::FlatBufferBuilder& builder, const Matrix6& covariance) {
  return put_square<6>(builder, covariance);
}

std::optional<Matrix12> state_covariance_of(const flatbuffers::Vector<double>* values) {
  return square_of<12>(values);
}

flatbuffers::Offset<flatbuffers::Vector<double>> put_covariance(
    flatbuffers::FlatBufferBuilder& builder, const std::optional<Matrix12>& covariance) {
  if (!covariance) return 0;
  return put_square<12>(builder, *covariance);
}

Submap submap_of(const msg::Submap& message) {
  Submap out;
  out.first_sweep = message.first_sweep();
  out.last_sweep = message.header()->sweep();
  out.sweep = message.frame_sweep();
  out.before_sweep = message.prev_frame_sweep();
  out.instant_ns = message.instant_ns();
  out.T_map_submap = pose_of(message.pose_map_submap());
  out.step_covariance = covariance_of(message.step_covariance());
  out.step_m = message.step_m();
  out.connected = message.connected();
  out.range_noise_m = static_cast<double>(message.range_noise_m());
  const auto points = map_points_of(message.points());
  out.points.assign(points.begin(), points.end());
  if (message.hits() != nullptr) out.hits.assign(message.hits()->begin(), message.hits()->end());
  for (const msg::Vec3& at : structs_of(message.origins())) {
    out.origins.emplace_back(at.x(), at.y(), at.z());
  }
  return out;
}

}  // namespace zloam
