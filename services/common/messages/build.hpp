#pragma once
// One function per kind of message, which builds it from plain values. Spans are only read during
// the call; every result is a finished buffer with its file identifier, ready to be published
// without a copy.

#include <flatbuffers/flatbuffers.h>

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "common/geometry/health.hpp"
#include "common/geometry/inertial_step.hpp"
#include "common/geometry/point.hpp"
#include "common/geometry/se3.hpp"
#include "common/geometry/submap.hpp"
#include "common/messages/header.hpp"
#include "common/messages/kinds.hpp"

namespace zloam {

using Buffer = flatbuffers::DetachedBuffer;

struct SweepFields {
  PointSpan points{};
  std::span<const std::uint16_t> columns{};
  std::uint32_t period_ns = 100'000'000;
  std::uint16_t rings = 0;
  std::string model{};
  msg::ReturnMode return_mode = msg::ReturnMode::Unknown;
  msg::ClockSource clock_source = msg::ClockSource::Unknown;
  bool complete = true;
  std::uint32_t packets = 0;
  std::uint32_t packets_lost = 0;
  std::span<const msg::ImuSample> imu{};
  bool imu_incomplete = false;
  bool deskewed = false;
  Health health = Health::kOk;
  std::uint32_t first_packet_toh_us = 0;
  std::uint32_t last_packet_toh_us = 0;
  std::uint32_t packet_period_ns = 0;
  std::int64_t host_clock_step_ns = 0;
  std::int64_t sensor_clock_step_ns = 0;
  std::uint16_t slices = 1;
};

struct FeaturesFields {
  std::uint32_t period_ns = 0;
  std::uint16_t rings = 0;
  PointSpan sharp{};
  PointSpan less_sharp{};
  PointSpan flat{};
  PointSpan less_flat{};
  std::uint32_t points_in = 0;
  std::uint32_t points_rejected = 0;
  Eigen::Vector3d removed_rotation = Eigen::Vector3d::Zero();
  Eigen::Vector3d removed_shift = Eigen::Vector3d::Zero();
  bool deskewed = false;
  Health health = Health::kOk;
  float range_noise_m = 0.0F;
  std::span<const msg::ImuSample> imu{};
  std::uint16_t slices = 1;
};

/// The least constrained direction, as in the schemas.
struct WeakFields {
  bool degenerate = false;
  Eigen::Vector3d weak_translation = Eigen::Vector3d::Zero();
  Eigen::Vector3d weak_rotation = Eigen::Vector3d::Zero();
  double sigma_measured = 0.0;
  double sigma_predicted = 0.0;
};

struct SolveFields {
  std::uint32_t iterations = 0;
  std::uint32_t correspondences = 0;
  double residual_m = 0.0;
};

struct OdometryFields {
  std::int64_t instant_ns = 0;
  Pose T_odom_base = Pose::Identity();
  Vector6 twist_per_s = Vector6::Zero();
  Matrix6 covariance = Matrix6::Zero();
  WeakFields weak{};
  SolveFields solve;
  Health health = Health::kOk;
  std::uint64_t prev_sweep = 0;
};

struct OdometryFeaturesFields {
  std::int64_t instant_ns = 0;
  Pose T_odom_base = Pose::Identity();
  Vector6 twist_per_s = Vector6::Zero();
  Matrix6 covariance = Matrix6::Zero();
  std::uint32_t period_ns = 0;
  Pose T_base_lidar = Pose::Identity();
  PointSpan edges{};
  PointSpan planes{};
  std::uint64_t prev_sweep = 0;
  Health health = Health::kOk;
  bool degenerate = false;
  float range_noise_m = 0.0F;
  /// covariance of pose and twist; left out when there is none
  std::optional<Matrix12> state_covariance{};
  /// left out when there is none
  std::optional<InertialStep> inertial{};
  std::span<const double> inertial_state{};
  double fit = 0.0;
  std::uint16_t slices = 1;
  /// left out when there is none
  std::span<const std::uint64_t> state{};
};

struct MapCorrectionFields {
  std::int64_t instant_ns = 0;
  Pose T_map_odom = Pose::Identity();
  Matrix6 covariance = Matrix6::Zero();
  Health health = Health::kOk;
  bool inserted = false;
  WeakFields weak{};
  SolveFields solve;
  std::uint64_t prev_sweep = 0;
  std::span<const std::uint64_t> state;
};

struct MapPoseFields {
  std::int64_t instant_ns = 0;
  Pose T_map_base = Pose::Identity();
  Vector6 twist_per_s = Vector6::Zero();
  Matrix6 covariance = Matrix6::Zero();
  std::uint64_t correction_sweep = 0;
  bool has_correction = false;
  bool jump = false;
  Health health = Health::kOk;
  WeakFields weak{};
};

struct MapTileFields {
  std::string layer{};
  std::int32_t i = 0, j = 0, k = 0;
  double edge_m = 0.0;
  std::uint64_t version = 0;
  std::span<const MapPoint> points{};
  std::span<const std::uint32_t> counts{};
  std::span<const msg::MapVoxel> voxels{};
  std::span<const std::uint32_t> leads{};
  double root_voxel_m = 0.0;
  std::uint8_t levels = 0;
  double range_noise_m = 0.0;
};

struct CloudFields {
  std::int64_t instant_ns = 0;
  std::span<const MapPoint> points{};
  Pose T_frame_base = Pose::Identity();
};

struct LoopFields {
  std::uint64_t from_sweep = 0, to_sweep = 0;
  Pose T_from_to = Pose::Identity();
  Matrix6 covariance = Matrix6::Zero();
  double overlap = 0.0;
  double residual_m = 0.0;
  double chi2 = 0.0;
  msg::LoopVerdict verdict = msg::LoopVerdict::Alone;
};

struct GraphPosesFields {
  std::uint32_t revision = 0;
  std::span<const msg::SubmapPose> poses{};
  std::uint32_t loops = 0;
  double chi2_before = 0.0, chi2_after = 0.0;
};

struct PreviewFields {
  std::uint32_t epoch = 0;
  std::int64_t instant_ns = 0;
  /// left out when there is none
  std::optional<Pose> T_map_base{};
  Health health = Health::kOk;
  bool degenerate = false;
  double block_m = 0.0;
  std::uint32_t map_blocks = 0;
  std::span<const msg::PreviewBlock> blocks{};
  std::span<const std::uint8_t> octrees{};
};

struct RejectedFields {
  PointSpan points{};
  std::span<const msg::RejectReason> reasons{};
};

struct PacketsFields {
  std::span<const msg::PacketEntry> entries{};
  std::span<const std::uint8_t> data{};
  std::string model{};
};

struct GnssFixFields {
  std::int64_t received_ns = 0;
  std::int64_t utc_ns = 0;
  double latitude_deg = 0.0;
  double longitude_deg = 0.0;
  bool valid = false;
  msg::PpsStatus pps = msg::PpsStatus::Absent;
  std::string sentence{};
};

struct ProgressFields {
  std::uint64_t run = 0;
  std::string instance{};
  std::uint64_t next_sweep = 0;
  std::vector<std::uint64_t> missing{};
  std::uint64_t seq = 0;
  std::uint64_t received_below = 0;
};

struct FlowAckFields {
  std::uint64_t run = 0;
  std::string sink{};
  std::string instance{};
  std::uint64_t done_below = 0;
  std::uint64_t seq = 0;
};

struct CommandReplyFields {
  bool ok = true;
  /// a sentence
  std::string message{};
  std::string results_json = "{}";
};

/// One change of a stage's configuration while it runs (schemas/config_revision.fbs).
struct ConfigRevisionFields {
  std::string stage{};
  std::uint32_t rev = 0;
  /// 0: the current run, or the next if there is none
  std::uint64_t run = 0;
  std::uint64_t from_sweep = 0;
  std::string values_json = "{}";
  std::string by{};
  std::int64_t at_ns = 0;
};

Buffer build(const HeaderFields& header, const SweepFields& fields);
Buffer build(const HeaderFields& header, const FeaturesFields& fields);
Buffer build(const HeaderFields& header, const OdometryFields& fields);
Buffer build(const HeaderFields& header, const OdometryFeaturesFields& fields);
Buffer build(const HeaderFields& header, const MapCorrectionFields& fields);
Buffer build(const HeaderFields& header, const MapPoseFields& fields);
Buffer build(const HeaderFields& header, const MapTileFields& fields);
Buffer build(const HeaderFields& header, const CloudFields& fields);
Buffer build(const HeaderFields& header, const Submap& submap);
Buffer build(const HeaderFields& header, const LoopFields& fields);
Buffer build(const HeaderFields& header, const GraphPosesFields& fields);
Buffer build(const HeaderFields& header, const PreviewFields& fields);
Buffer build(const HeaderFields& header, const RejectedFields& fields);
Buffer build(const HeaderFields& header, const PacketsFields& fields);
Buffer build_angles(const HeaderFields& header, std::span<const msg::AngleReading> readings);
Buffer build_imu(const HeaderFields& header, std::span<const msg::ImuSample> samples,
                 msg::ClockSource clock_source);
Buffer build_gnss(const HeaderFields& header, std::span<const GnssFixFields> fixes);
Buffer build_path(const HeaderFields& header, std::span<const msg::StampedPose> poses);
Buffer build(const ProgressFields& fields);
Buffer build(const FlowAckFields& fields);
Buffer build(const ConfigRevisionFields& fields);
/// Request and reply of a command share the file identifier; the root differs.
Buffer build_command(const std::string& arguments_json);
Buffer build(const CommandReplyFields& fields);

}  // namespace zloam
