#pragma once
// Conversions between the messages' structs and the geometry of the algorithms. Arrays of points
// are read in place.

#include <flatbuffers/flatbuffers.h>

#include <cstddef>
#include <cstring>
#include <optional>
#include <span>
#include <vector>

#include "common/geometry/health.hpp"
#include "common/geometry/imu_reading.hpp"
#include "common/geometry/inertial_step.hpp"
#include "common/geometry/point.hpp"
#include "common/geometry/se3.hpp"
#include "common/geometry/submap.hpp"
#include "schemas/common_generated.h"
#include "schemas/odometry_features_generated.h"
#include "schemas/submap_generated.h"
#include "schemas/sweep_generated.h"

namespace zloam {

static_assert(sizeof(msg::Point) == sizeof(Point) && alignof(msg::Point) == alignof(Point));
static_assert(offsetof(Point, x) == 0 && offsetof(Point, y) == 4 && offsetof(Point, z) == 8 &&
              offsetof(Point, intensity) == 12 && offsetof(Point, time_ns) == 16 &&
              offsetof(Point, ring) == 20 && offsetof(Point, return_type) == 22 &&
              offsetof(Point, reserved) == 23);
static_assert(sizeof(msg::MapPoint) == sizeof(MapPoint) &&
              alignof(msg::MapPoint) == alignof(MapPoint));

/// The points of a message in place; empty when the field is absent. Valid as long as the message.
PointSpan points_of(const flatbuffers::Vector<const msg::Point*>* vector);
std::span<const MapPoint> map_points_of(const flatbuffers::Vector<const msg::MapPoint*>* vector);
template <class Struct>
std::span<const Struct> structs_of(const flatbuffers::Vector<const Struct*>* vector) {
  if (vector == nullptr) return {};
  return {reinterpret_cast<const Struct*>(vector->Data()), vector->size()};
}

/// Whether each firing of the sweep has one return, so that there is none to select, whatever type it
/// has.
inline bool has_one_return(const msg::Sweep& sweep) {
  return sweep.return_mode() == msg::ReturnMode::Strongest ||
         sweep.return_mode() == msg::ReturnMode::Last;
}

/// Empty when the field is absent.
template <class Number>
std::span<const Number> numbers_of(const flatbuffers::Vector<Number>* vector) {
  if (vector == nullptr) return {};
  return {vector->data(), vector->size()};
}

/// The message must have been verified.
Submap submap_of(const msg::Submap& message);

/// One copy of the points into a message under construction.
flatbuffers::Offset<flatbuffers::Vector<const msg::Point*>> put_points(
    flatbuffers::FlatBufferBuilder& builder, PointSpan points);
flatbuffers::Offset<flatbuffers::Vector<const msg::MapPoint*>> put_points(
    flatbuffers::FlatBufferBuilder& builder, std::span<const MapPoint> points);
template <class Struct>
flatbuffers::Offset<flatbuffers::Vector<const Struct*>> put_structs(
    flatbuffers::FlatBufferBuilder& builder, std::span<const Struct> items) {
  return builder.CreateVectorOfStructs(items.data(), items.size());
}

/// Same numbers, quaternion normalised.
Pose pose_of(const msg::Pose& pose);
/// Identity when the field is absent.
Pose pose_of(const msg::Pose* pose);
msg::Pose to_message(const Pose& pose);
Eigen::Vector3d vector_of(const msg::Vec3& v);
Eigen::Vector3d vector_of(const msg::Vec3* v);
msg::Vec3 to_message(const Eigen::Vector3d& v);
/// A copy; empty when the field is absent.
std::vector<ImuReading> imu_of(const flatbuffers::Vector<const msg::ImuSample*>* samples);
msg::ImuSample to_message(const ImuReading& reading);
/// (linear, angular) as (translation, rotation).
Vector6 twist_of(const msg::Twist* twist);
msg::Twist twist_message(const Vector6& twist_per_s);
/// Row-major 6x6; zero when the field is absent.
Matrix6 covariance_of(const flatbuffers::Vector<double>* values);
flatbuffers::Offset<flatbuffers::Vector<double>> put_covariance(
    flatbuffers::FlatBufferBuilder& builder, const Matrix6& covariance);
/// The IMU's preintegrated motion; none when its covariance is absent.
std::optional<InertialStep> inertial_step_of(const msg::OdometryFeatures& message);
/// Row-major 12x12, of pose and twist; none when the field is absent.
std::optional<Matrix12> state_covariance_of(const flatbuffers::Vector<double>* values);
flatbuffers::Offset<flatbuffers::Vector<double>> put_covariance(
    flatbuffers::FlatBufferBuilder& builder, const std::optional<Matrix12>& covariance);

inline Health health_of(msg::Health health) { return static_cast<Health>(health); }
inline msg::Health to_message(Health health) { return static_cast<msg::Health>(health); }

}  // namespace zloam
