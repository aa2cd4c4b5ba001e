// Every faulty message is refused with a reason; nothing is read beyond the payload.

#include "common/messages/verify.hpp"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstring>
#include <limits>
#include <memory>
#include <vector>

#include "common/messages/build.hpp"
#include "common/messages/convert.hpp"

namespace zloam {
namespace {

HeaderFields header() {
  HeaderFields h;
  h.robot = "r";
  h.instance = "a";
  h.frame = "lidar";
  return h;
}

/// A buffer as a receiver holds it: aligned for the widest member.
class Aligned {
 public:
  explicit Aligned(const Buffer& buffer) : size_(buffer.size()), block_(size_ / 8 + 1) {
    std::memcpy(block_.data(), buffer.data(), size_);
  }
  std::span<const std::uint8_t> bytes() const {
    return {reinterpret_cast<const std::uint8_t*>(block_.data()), size_};
  }

 private:
  std::size_t size_;
  std::vector<std::uint64_t> block_;
};

template <class T>
VerifyResult check(const Buffer& buffer) {
  return verify<T>(Aligned(buffer).bytes(), encoding_of_schema(Kind<T>::kSchema));
}

Point point() { return {1.0F, 2.0F, 3.0F, 4.0F, 5U, 3, ReturnType::kStrongest, 0}; }

const std::string kSweepEncoding = "application/x-flatbuffers;schema=sweep;major=1";

TEST(Verify, EncodingAndIdentifierComeFirst) {
  const Aligned aligned(build(header(), SweepFields{}));
  const std::span<const std::uint8_t> bytes = aligned.bytes();
  EXPECT_TRUE(verify<msg::Sweep>(bytes, kSweepEncoding).ok());
  for (const char* wrong :
       {"", "application/json", "application/x-flatbuffers;schema=features;major=1",
        "application/x-flatbuffers;schema=sweep;major=2"}) {
    const VerifyResult result = verify<msg::Sweep>(bytes, wrong);
    EXPECT_EQ(result.status, VerifyStatus::kGarbage);
    EXPECT_NE(result.reason.find("encoding"), std::string::npos);
  }
  const VerifyResult other =
      verify<msg::Features>(bytes, "application/x-flatbuffers;schema=features;major=1");
  EXPECT_EQ(other.status, VerifyStatus::kGarbage);
  EXPECT_NE(other.reason.find("ZLFE"), std::string::npos);
}

TEST(Verify, EveryTruncationIsRefusedWithoutReadingBeyond) {
  const PointVector points(20, point());
  const Buffer buffer = build(header(), SweepFields{.points = points, .rings = 16});
  for (std::size_t size = 0; size < buffer.size(); ++size) {
    // A block of exactly this size, so that the address sanitizer sees a read beyond.
    std::unique_ptr<std::uint64_t[]> block(new std::uint64_t[size / 8 + 1]);
    auto* end = reinterpret_cast<std::uint8_t*>(block.get() + size / 8 + 1);
    std::uint8_t* start = end - (size / 8 + 1) * 8;
    std::memcpy(start, buffer.data(), size);
    const VerifyResult result = verify<msg::Sweep>({start, size}, kSweepEncoding);
    EXPECT_EQ(result.status, VerifyStatus::kGarbage) << size;
    EXPECT_FALSE(result.reason.empty());
  }
}

TEST(Verify, EverySingleDamagedByteIsRefusedOrHarmless) {
  const PointVector points(4, point());
  const Buffer buffer = build(header(), FeaturesFields{.rings = 16, .sharp = points});
  std::vector<std::uint64_t> block(buffer.size() / 8 + 1);
  auto* bytes = reinterpret_cast<std::uint8_t*>(block.data());
  for (std::size_t at = 0; at < buffer.size(); ++at) {
    std::memcpy(bytes, buffer.data(), buffer.size());
    bytes[at] ^= 0xFF;
    const std::span<const std::uint8_t> view(bytes, buffer.size());
    if (!verify<msg::Features>(view, encoding_of_schema("features")).ok()) continue;
    // An accepted message must be readable to its last point.
    const msg::Features& m = message_of<msg::Features>(view);
    for (const Point& p : points_of(m.sharp())) EXPECT_TRUE(std::isfinite(p.x));
    EXPECT_NE(m.header(), nullptr);
  }
}

TEST(Verify, UnalignedBytesAreRefused) {
  const Buffer buffer = build(header(), SweepFields{});
  std::vector<std::uint64_t> block(buffer.size() / 8 + 2);
  auto* bytes = reinterpret_cast<std::uint8_t*>(block.data()) + 4;
  std::memcpy(bytes, buffer.data(), buffer.size());
  EXPECT_EQ(verify<msg::Sweep>({bytes, buffer.size()}, kSweepEncoding).status,
            VerifyStatus::kGarbage);
}

void expect_invalid(const VerifyResult& result, const std::string& word) {
  EXPECT_EQ(result.status, VerifyStatus::kInvalid) << word;
  EXPECT_NE(result.reason.find(word), std::string::npos) << result.reason;
}

TEST(Verify, OctreesOfAPreviewMustBeAsLongAsItsBlocksSay) {
  const std::vector<msg::PreviewBlock> blocks = {{1, 2, 3, 2, 2, 0}, {1, 2, 4, 1, 1, 0}};
  const std::vector<std::uint8_t> three = {1, 1, 1}, two = {1, 1};
  PreviewFields fields{.block_m = 12.5, .blocks = blocks, .octrees = three};
  EXPECT_TRUE(check<msg::Preview>(build(header(), fields)).ok());
  fields.octrees = two;
  expect_invalid(check<msg::Preview>(build(header(), fields)), "octrees");
  fields.octrees = three;
  fields.block_m = -1.0;
  expect_invalid(check<msg::Preview>(build(header(), fields)), "block_m");
  fields.block_m = std::nan("");
  expect_invalid(check<msg::Preview>(build(header(), fields)), "block_m");
}

TEST(Verify, RingsMustBeBelowTheirNumber) {
  const PointVector points(1, point());
  expect_invalid(check<msg::Sweep>(build(header(), SweepFields{.points = points, .rings = 3})),
                 "ring");
  EXPECT_TRUE(check<msg::Sweep>(build(header(), SweepFields{.points = points, .rings = 4})).ok());
}

TEST(Verify, ParallelVectorsMustBeEquallyLong) {
  const PointVector points(2, point());
  const std::vector<std::uint16_t> columns(1);
  expect_invalid(check<msg::Sweep>(build(
                     header(), SweepFields{.points = points, .columns = columns, .rings = 16})),
                 "columns");
  expect_invalid(check<msg::Rejected>(build(header(), RejectedFields{points, {}})), "reasons");
}

TEST(Verify, SweepsMayHoldCellsWithoutReturnFeaturesMayNot) {
  Point nan = point();
  nan.x = std::numeric_limits<float>::quiet_NaN();
  const PointVector points(3, nan);
  EXPECT_TRUE(check<msg::Sweep>(build(header(), SweepFields{.points = points, .rings = 16})).ok());
  expect_invalid(check<msg::Features>(build(header(), FeaturesFields{.rings = 16, .flat = points})),
                 "flat");
  expect_invalid(check<msg::OdometryFeatures>(
                     build(header(), OdometryFeaturesFields{.edges = points, .planes = {}})),
                 "edges");
}

TEST(Verify, AnInertialStateMustBeFinite) {
  const std::array numbers = {1.0, std::numeric_limits<double>::quiet_NaN()};
  OdometryFeaturesFields odometry;
  odometry.inertial_state = numbers;
  expect_invalid(check<msg::OdometryFeatures>(build(header(), odometry)), "inertial_state");
}

TEST(Verify, PosesMustBeFiniteAndOfUnitLength) {
  OdometryFields f;
  f.T_odom_base.translation().x() = std::numeric_limits<double>::infinity();
  expect_invalid(check<msg::Odometry>(build(header(), f)), "pose_odom_base");
  f = {};
  f.covariance(2, 3) = std::nan("");
  expect_invalid(check<msg::Odometry>(build(header(), f)), "covariance");
  f = {};
  f.twist_per_s[4] = std::nan("");
  expect_invalid(check<msg::Odometry>(build(header(), f)), "twist");

  flatbuffers::FlatBufferBuilder b;
  const auto head = build_header(b, header());
  const msg::Pose skewed(msg::Vec3(0, 0, 0), msg::Quat(0, 0, 0, 1.01));
  msg::MapCorrectionBuilder m(b);
  m.add_header(head);
  m.add_pose_map_odom(&skewed);
  b.Finish(m.Finish(), Kind<msg::MapCorrection>::kIdentifier);
  expect_invalid(check<msg::MapCorrection>(b.Release()), "unit length");
}

// Found by tests/fuzz: stamps near the ends of 64 bits overflowed in the first sum.
TEST(Verify, TimesMustBeOfThisCentury) {
  using Limits = std::numeric_limits<std::int64_t>;
  for (const std::int64_t wrong_ns : {Limits::max(), Limits::min(), Limits::max() - 100'000'000}) {
    HeaderFields stamped = header();
    stamped.stamp_ns = wrong_ns;
    expect_invalid(check<msg::Sweep>(build(stamped, SweepFields{})), "stamp_ns");
    OdometryFields odometry;
    odometry.instant_ns = wrong_ns;
    expect_invalid(check<msg::Odometry>(build(header(), odometry)), "instant_ns");
    OdometryFeaturesFields features;
    features.instant_ns = wrong_ns;
    expect_invalid(check<msg::OdometryFeatures>(build(header(), features)), "instant_ns");
    MapPoseFields pose;
    pose.instant_ns = wrong_ns;
    expect_invalid(check<msg::MapPose>(build(header(), pose)), "instant_ns");
    MapCorrectionFields correction;
    correction.instant_ns = wrong_ns;
    expect_invalid(check<msg::MapCorrection>(build(header(), correction)), "instant_ns");
  }
  for (const std::int64_t right_ns : {std::int64_t{0}, std::int64_t{1'764'000'000'000'000'000}}) {
    HeaderFields stamped = header();
    stamped.stamp_ns = right_ns;
    EXPECT_TRUE(check<msg::Sweep>(build(stamped, SweepFields{})).ok()) << right_ns;
  }
}

// Found by tests/fuzz: without a period, a NaN covariance was published.
TEST(Verify, SweepsAndFeaturesWithPointsHaveAPeriod) {
  const PointVector points(3, point());
  expect_invalid(check<msg::Sweep>(
                     build(header(), SweepFields{.points = points, .period_ns = 0, .rings = 16})),
                 "period_ns");
  FeaturesFields f{.rings = 16, .less_flat = points};
  expect_invalid(check<msg::Features>(build(header(), f)), "period_ns");
  f.period_ns = 100'000'000;
  EXPECT_TRUE(check<msg::Features>(build(header(), f)).ok());
  EXPECT_TRUE(check<msg::Features>(build(header(), FeaturesFields{.rings = 16})).ok());
  OdometryFeaturesFields odometry{.planes = points};
  expect_invalid(check<msg::OdometryFeatures>(build(header(), odometry)), "period_ns");
  odometry.period_ns = 100'000'000;
  EXPECT_TRUE(check<msg::OdometryFeatures>(build(header(), odometry)).ok());
  EXPECT_TRUE(check<msg::OdometryFeatures>(build(header(), OdometryFeaturesFields{})).ok());
}

TEST(Verify, CovarianceHas36ValuesOrNone) {
  for (const std::size_t size : {0U, 1U, 35U, 36U, 37U}) {
    flatbuffers::FlatBufferBuilder b;
    const auto head = build_header(b, header());
    const auto covariance = b.CreateVector(std::vector<double>(size, 1.0));
    const msg::Pose pose = to_message(Pose(Pose::Identity()));
    msg::OdometryBuilder m(b);
    m.add_header(head);
    m.add_pose_odom_base(&pose);
    m.add_covariance(covariance);
    b.Finish(m.Finish(), Kind<msg::Odometry>::kIdentifier);
    EXPECT_EQ(check<msg::Odometry>(b.Release()).ok(), size == 0 || size == 36) << size;
  }
}

TEST(Verify, HeaderMustBeThere) {
  flatbuffers::FlatBufferBuilder b;
  b.Finish(msg::SweepBuilder(b).Finish(), Kind<msg::Sweep>::kIdentifier);
  expect_invalid(check<msg::Sweep>(b.Release()), "header");
  HeaderFields nameless = header();
  nameless.instance.clear();
  expect_invalid(check<msg::Sweep>(build(nameless, SweepFields{})), "instance");
}

TEST(Verify, PacketEntriesLieWithinTheData) {
  const std::vector<std::uint8_t> data(10);
  const msg::PacketEntry entry(0, 5, 6, 2368);
  expect_invalid(check<msg::Packets>(build(header(), PacketsFields{{&entry, 1}, data, "VLP-16"})),
                 "outside");
}

}  // namespace
}  // namespace zloam
