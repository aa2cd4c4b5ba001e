// What was put in comes out, through the verifier.

#include "common/messages/build.hpp"

#include <gtest/gtest.h>

#include <array>
#include <cstring>
#include <numbers>

#include "common/messages/convert.hpp"
#include "common/messages/ranges.hpp"
#include "common/messages/verify.hpp"

namespace zloam {
namespace {

HeaderFields sample_header() {
  HeaderFields h;
  h.robot = "r";
  h.sensor = "top";
  h.run = 0xFEDCBA9876543210ULL;
  h.sweep = 41;
  h.stamp_ns = 1'700'000'000'123'456'789;
  h.frame = "lidar";
  h.seq = 7;
  h.term = 3;
  h.instance = "a";
  h.odom_epoch = 2;
  h.map_id = 99;
  h.config_rev = 5;
  h.trace = {{"driver", "host1", "d", 1, 2, 3}, {"registration", "host1", "a", 4, 5, 6}};
  h.end_of_run = true;
  h.last_packet_ns = 12;
  h.replay = true;
  return h;
}

void expect_same(const HeaderFields& a, const HeaderFields& b) {
  EXPECT_EQ(a.robot, b.robot);
  EXPECT_EQ(a.sensor, b.sensor);
  EXPECT_EQ(a.run, b.run);
  EXPECT_EQ(a.sweep, b.sweep);
  EXPECT_EQ(a.stamp_ns, b.stamp_ns);
  EXPECT_EQ(a.frame, b.frame);
  EXPECT_EQ(a.seq, b.seq);
  EXPECT_EQ(a.term, b.term);
  EXPECT_EQ(a.instance, b.instance);
  EXPECT_EQ(a.odom_epoch, b.odom_epoch);
  EXPECT_EQ(a.map_id, b.map_id);
  EXPECT_EQ(a.config_rev, b.config_rev);
  EXPECT_EQ(a.end_of_run, b.end_of_run);
  EXPECT_EQ(a.last_packet_ns, b.last_packet_ns);
  EXPECT_EQ(a.replay, b.replay);
  ASSERT_EQ(a.trace.size(), b.trace.size());
  for (std::size_t i = 0; i < a.trace.size(); ++i) {
    EXPECT_EQ(a.trace[i].stage, b.trace[i].stage);
    EXPECT_EQ(a.trace[i].instance, b.trace[i].instance);
    EXPECT_EQ(a.trace[i].received_ns, b.trace[i].received_ns);
    EXPECT_EQ(a.trace[i].published_ns, b.trace[i].published_ns);
  }
}

template <class T>
const T& checked(const Buffer& buffer) {
  const std::span<const std::uint8_t> bytes(buffer.data(), buffer.size());
  // The header's 64-bit members make every builder align to 8 bytes.
  const VerifyResult result = verify<T>(bytes, encoding_of_schema(Kind<T>::kSchema));
  EXPECT_TRUE(result.ok()) << result.reason;
  return message_of<T>(bytes);
}

Point point(float x, std::uint16_t ring) {
  return {x, 2.0F, 3.0F, 4.0F, 5U, ring, ReturnType::kLast, 0};
}

Pose sample_pose() { return pose_from_xyz_rpy_deg({1.0, -2.0, 3.0}, {10.0, -80.0, 170.0}); }

TEST(Build, HeaderComesBack) {
  const Buffer buffer = build(sample_header(), SweepFields{});
  expect_same(header_fields(*checked<msg::Sweep>(buffer).header()), sample_header());
}

TEST(Build, SweepPointsAreReadInPlaceWithTheSameBytes) {
  const PointVector points = {point(1.0F, 0), point(-1.5F, 15)};
  const std::vector<std::uint16_t> columns = {3, 4};
  const msg::ImuSample imu(77, msg::Vec3(0, 0, 9.81), msg::Vec3(0.1, 0.2, 0.3));
  const Buffer buffer = build(sample_header(), SweepFields{.points = points,
                                                           .columns = columns,
                                                           .period_ns = 100'000'000,
                                                           .rings = 16,
                                                           .model = "VLP-16",
                                                           .packets = 76,
                                                           .imu = {&imu, 1},
                                                           .health = Health::kIncomplete});
  const msg::Sweep& m = checked<msg::Sweep>(buffer);
  const PointSpan read = points_of(m.points());
  ASSERT_EQ(read.size(), 2U);
  EXPECT_EQ(std::memcmp(read.data(), points.data(), sizeof(Point) * 2), 0);
  const auto* begin = reinterpret_cast<const Point*>(buffer.data());
  EXPECT_TRUE(read.data() > begin && read.data() < begin + buffer.size());
  EXPECT_EQ(m.columns()->Get(1), 4);
  EXPECT_EQ(m.model()->str(), "VLP-16");
  EXPECT_EQ(m.imu()->Get(0)->stamp_ns(), 77);
  EXPECT_EQ(health_of(m.health()), Health::kIncomplete);
  // The struct as flatc sees it and the one of the algorithms agree member by member.
  EXPECT_EQ(m.points()->Get(1)->ring(), 15);
  EXPECT_EQ(m.points()->Get(1)->x(), -1.5F);
  EXPECT_EQ(m.points()->Get(1)->time_ns(), 5U);
  EXPECT_EQ(m.points()->Get(1)->return_type(), msg::ReturnType::Last);
}

TEST(Build, OdometryKeepsPoseTwistAndCovariance) {
  OdometryFields f;
  f.T_odom_base = sample_pose();
  f.twist_per_s << 1, 2, 3, 4, 5, 6;
  for (int i = 0; i < 36; ++i) f.covariance(i / 6, i % 6) = i;
  f.solve.iterations = 100'000;  // more than the field holds: saturates
  f.prev_sweep = 40;
  const Buffer buffer = build(sample_header(), f);
  const msg::Odometry& m = checked<msg::Odometry>(buffer);
  EXPECT_TRUE(pose_of(m.pose_odom_base()).isApprox(f.T_odom_base, 1e-12));
  EXPECT_EQ(twist_of(m.twist()), f.twist_per_s);
  EXPECT_EQ(covariance_of(m.covariance()), f.covariance);
  EXPECT_EQ(m.covariance()->Get(1), 1.0);  // row-major on the wire
  EXPECT_EQ(m.iterations(), 65535);
  EXPECT_EQ(m.prev_sweep(), 40U);
}

TEST(Build, QuaternionFollowsHamilton) {
  // A quarter turn about z carries x to y.
  Pose turn = Pose::Identity();
  turn.linear() =
      Eigen::AngleAxisd(std::numbers::pi / 2, Eigen::Vector3d::UnitZ()).toRotationMatrix();
  const msg::Pose m = to_message(turn);
  EXPECT_NEAR(m.rotation().z(), std::sqrt(0.5), 1e-12);
  EXPECT_NEAR(m.rotation().w(), std::sqrt(0.5), 1e-12);
  EXPECT_TRUE((pose_of(m) * Eigen::Vector3d::UnitX()).isApprox(Eigen::Vector3d::UnitY(), 1e-12));
}

TEST(Build, EveryOtherKindPassesItsOwnVerifier) {
  const PointVector points = {point(1.0F, 0)};
  const std::vector<MapPoint> map_points = {{1, 2, 3, 4}};
  const std::vector<msg::RejectReason> reasons = {msg::RejectReason::Occluded};
  const HeaderFields h = sample_header();
  EXPECT_EQ(
      checked<msg::Features>(build(h, FeaturesFields{.rings = 1, .sharp = points})).sharp()->size(),
      1U);
  const Buffer features = build(h, OdometryFeaturesFields{.edges = points, .planes = points});
  EXPECT_EQ(points_of(checked<msg::OdometryFeatures>(features).planes()).size(), 1U);
  MapCorrectionFields correction;
  correction.T_map_odom = sample_pose();
  const Buffer corrected = build(h, correction);
  EXPECT_TRUE(pose_of(checked<msg::MapCorrection>(corrected).pose_map_odom())
                  .isApprox(sample_pose(), 1e-12));
  EXPECT_TRUE(checked<msg::MapPose>(build(h, MapPoseFields{.jump = true})).jump());
  const Buffer tile = build(
      h,
      MapTileFields{.layer = "edge", .i = -1, .edge_m = 50.0, .version = 3, .points = map_points});
  EXPECT_EQ(map_points_of(checked<msg::MapTile>(tile).points())[0].z, 3.0F);
  const Buffer cloud = build(h, CloudFields{.instant_ns = 5, .points = map_points});
  EXPECT_EQ(checked<msg::Cloud>(cloud).instant_ns(), 5);
  const Buffer rejected = build(h, RejectedFields{points, reasons});
  EXPECT_EQ(checked<msg::Rejected>(rejected).reasons()->Get(0), msg::RejectReason::Occluded);
  const std::vector<std::uint8_t> data(10, 1);
  const msg::PacketEntry entry(1, 0, 10, 2368);
  EXPECT_EQ(
      checked<msg::Packets>(build(h, PacketsFields{{&entry, 1}, data, "VLP-16"})).data()->size(),
      10U);
  const msg::StampedPose stamped(1, 2, to_message(sample_pose()));
  EXPECT_EQ(checked<msg::Path>(build_path(h, {&stamped, 1})).poses()->Get(0)->sweep(), 2U);
  const GnssFixFields fix{.latitude_deg = 50.0, .sentence = "$GPRMC"};
  EXPECT_EQ(checked<msg::GnssBatch>(build_gnss(h, {&fix, 1})).fixes()->Get(0)->sentence()->str(),
            "$GPRMC");
  EXPECT_EQ(checked<msg::Progress>(
                build(ProgressFields{.run = 1, .instance = "a", .next_sweep = 3, .missing = {4}}))
                .missing()
                ->Get(0),
            4U);
  EXPECT_EQ(checked<msg::FlowAck>(build(FlowAckFields{1, "mapping", "a", 9, 0})).done_below(), 9U);
  const Buffer revision = build(
      ConfigRevisionFields{.stage = "odometry", .rev = 2, .run = 1, .from_sweep = 30, .by = "a"});
  EXPECT_EQ(checked<msg::ConfigRevision>(revision).from_sweep(), 30U);
  EXPECT_EQ(checked<msg::Command>(build_command("{}")).arguments_json()->str(), "{}");
}

TEST(Build, VoxelsAndHowFarTheirRingsLead) {
  const std::array<msg::MapVoxel, 2> voxels{};
  const std::array<std::uint32_t, 2> leads{7, 9};
  MapTileFields fields{.layer = "voxels", .edge_m = 12.5, .voxels = voxels, .leads = leads};
  const Buffer whole = build(sample_header(), fields);
  EXPECT_EQ(checked<msg::MapTile>(whole).leads()->Get(1), 9U);
  fields.leads = std::span(leads).first(1);
  const Buffer one_missing = build(sample_header(), fields);
  EXPECT_EQ(range_error(*flatbuffers::GetRoot<msg::MapTile>(one_missing.data())),
            "leads: not as many as voxels");
}

TEST(Build, InertialReadingsComeBack) {
  const ImuReading reading{1'700'000'000'000'000'005, {0.1, -0.2, 9.8}, {0.01, 0.02, -0.03}};
  const std::array samples = {to_message(reading), to_message(reading)};
  FeaturesFields features;
  features.imu = samples;
  const Buffer buffer = build(sample_header(), features);
  const std::vector<ImuReading> back = imu_of(checked<msg::Features>(buffer).imu());
  ASSERT_EQ(back.size(), 2U);
  EXPECT_EQ(back[1].stamp_ns, reading.stamp_ns);
  EXPECT_EQ(back[1].force_mps2, reading.force_mps2);
  EXPECT_EQ(back[1].rate_radps, reading.rate_radps);
}

TEST(Build, AnInertialStepComesBackOrIsNotThere) {
  OdometryFeaturesFields fields;
  const Buffer without = build(sample_header(), fields);
  EXPECT_FALSE(inertial_step_of(checked<msg::OdometryFeatures>(without)));
  EXPECT_EQ(checked<msg::OdometryFeatures>(without).inertial_state(), nullptr);
  InertialStep step;
  step.velocity_change_mps << 0.1, 0.2, 0.3;
  step.turn_rad << -0.01, 0.02, 0.05;
  step.covariance.setRandom();
  step.at_rest = true;
  fields.inertial = step;
  const std::array numbers = {1.0, 2.5, -3.0};
  fields.inertial_state = numbers;
  const Buffer buffer = build(sample_header(), fields);
  const msg::OdometryFeatures& message = checked<msg::OdometryFeatures>(buffer);
  const auto back = inertial_step_of(message);
  ASSERT_TRUE(back);
  EXPECT_EQ(back->velocity_change_mps, step.velocity_change_mps);
  EXPECT_EQ(back->turn_rad, step.turn_rad);
  EXPECT_EQ(back->covariance, step.covariance);
  EXPECT_TRUE(back->at_rest);
  ASSERT_EQ(message.inertial_state()->size(), 3U);
  EXPECT_EQ(message.inertial_state()->Get(1), 2.5);
}

}  // namespace
}  // namespace zloam
