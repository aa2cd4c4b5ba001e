// Compares the encoder and decoder with CDR bytes composed by hand after the specification.

#include "ros/cdr.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <random>

namespace zloam::ros {
namespace {

/// Composes an Imu message field by field: 4 bytes of header, then each number at an offset behind
/// the header that is a multiple of its size.
class ImuBytes {
 public:
  explicit ImuBytes(bool little) : little_(little) { bytes_ = {0, std::uint8_t{little}, 0, 0}; }

  template <class T>
  ImuBytes& add(T value) {
    while ((bytes_.size() - 4) % sizeof(T) != 0) bytes_.push_back(0);
    std::array<std::uint8_t, sizeof(T)> raw{};
    std::memcpy(raw.data(), &value, sizeof(T));
    if (!little_) std::reverse(raw.begin(), raw.end());
    bytes_.insert(bytes_.end(), raw.begin(), raw.end());
    return *this;
  }
  ImuBytes& text(const std::string& s) {
    add(static_cast<std::uint32_t>(s.size() + 1));
    bytes_.insert(bytes_.end(), s.begin(), s.end());
    bytes_.push_back(0);
    return *this;
  }
  ImuBytes& covariance(double first) {
    add(first);
    for (int i = 0; i < 8; ++i) add(0.0);
    return *this;
  }
  const Cdr& bytes() const { return bytes_; }

 private:
  bool little_;
  Cdr bytes_;
};

Cdr imu_bytes(bool little, double of_force = 0.0, double force_z = 9.75,
              std::int32_t seconds = 1'700'000'000) {
  ImuBytes b(little);
  b.add(seconds).add(std::uint32_t{250'000'000}).text("imu");
  b.add(0.0).add(0.0).add(0.0).add(1.0).covariance(-1.0);
  b.add(0.125).add(-0.25).add(0.5).covariance(0.0);
  b.add(1.5).add(-2.5).add(force_z).covariance(of_force);
  return b.bytes();
}

TEST(Cdr, AnImuIsReadInEitherByteOrder) {
  for (const bool little : {true, false}) {
    const auto reading = decode_imu(imu_bytes(little));
    ASSERT_TRUE(reading);
    EXPECT_EQ(reading->stamp_ns, 1'700'000'000'250'000'000);
    EXPECT_EQ(reading->rate_radps, Eigen::Vector3d(0.125, -0.25, 0.5));
    EXPECT_EQ(reading->force_mps2, Eigen::Vector3d(1.5, -2.5, 9.75));
  }
}

TEST(Cdr, AnImuWithoutAccelerationOrWithWildNumbersIsNone) {
  EXPECT_FALSE(decode_imu(imu_bytes(true, -1.0)));
  EXPECT_FALSE(decode_imu(imu_bytes(true, 0.0, std::numeric_limits<double>::quiet_NaN())));
}

// The driver refuses a message with such a reading as a whole, with the good ones beside it.
TEST(Cdr, AnImuThatTheDriverWouldRefuseIsNone) {
  EXPECT_TRUE(decode_imu(imu_bytes(true, 0.0, -1e6, 0)));
  EXPECT_FALSE(decode_imu(imu_bytes(true, 0.0, -1.001e6)));
  EXPECT_FALSE(decode_imu(imu_bytes(true, 0.0, 9.75, -2'000'000'000)));
}

Cdr place_bytes(bool little, double z, double w, const char* frame = "map") {
  ImuBytes b(little);
  b.add(std::int32_t{1'700'000'000}).add(std::uint32_t{0}).text(frame);
  b.add(12.0).add(-3.5).add(0.25).add(0.0).add(0.0).add(z).add(w);
  for (int i = 0; i < 36; ++i) b.add(0.0);
  return b.bytes();
}

TEST(Cdr, APlaceIsReadInEitherByteOrder) {
  for (const bool little : {true, false}) {
    const auto place = decode_place(place_bytes(little, std::sin(0.4), std::cos(0.4)));
    ASSERT_TRUE(place);
    EXPECT_EQ(place->frame, "map");
    EXPECT_EQ(place->x_m, 12.0);
    EXPECT_EQ(place->y_m, -3.5);
    EXPECT_NEAR(place->yaw_rad, 0.8, 1e-12);
  }
}

// The name becomes part of the status.
TEST(Cdr, APlaceInAFrameOfAnEndlessNameIsNone) {
  EXPECT_TRUE(decode_place(place_bytes(true, 0.0, 1.0, std::string(255, 'm').c_str())));
  EXPECT_FALSE(decode_place(place_bytes(true, 0.0, 1.0, std::string(1'000'000, 'm').c_str())));
}

TEST(Cdr, APlaceWithoutARotationOrCutIsNone) {
  EXPECT_FALSE(decode_place(place_bytes(true, 0.0, 0.0)));
  EXPECT_FALSE(decode_place(place_bytes(true, 0.0, std::numeric_limits<double>::quiet_NaN())));
  const Cdr whole = place_bytes(true, 0.0, 1.0);
  for (std::size_t n = 0; n < whole.size(); ++n) {
    EXPECT_FALSE(decode_place({whole.data(), n})) << n;
  }
}

TEST(Cdr, WhatIsCutOrDamagedIsReadAsNothingOrAsNumbers) {
  const Cdr whole = imu_bytes(true);
  for (std::size_t n = 0; n < whole.size(); ++n) {
    EXPECT_FALSE(decode_imu({whole.data(), n})) << n;
  }
  std::mt19937 random(7);
  for (int i = 0; i < 20'000; ++i) {
    Cdr damaged = whole;
    for (int k = 0; k < 4; ++k) damaged[random() % damaged.size()] ^= 1U << (random() % 8);
    if (const auto reading = decode_imu(damaged)) {
      EXPECT_TRUE(reading->force_mps2.allFinite());
    }
  }
}

TEST(Cdr, TransformsBeginAsTheSpecificationSays) {
  Pose pose = Pose::Identity();
  pose.translation() = Eigen::Vector3d(1.0, 2.0, 3.0);
  const Cdr bytes = encode(std::vector<TransformMessage>{{{-500'000'000, "odom"}, "base", pose}});
  ImuBytes wanted(true);
  wanted.add(std::uint32_t{1}).add(std::int32_t{-1}).add(std::uint32_t{500'000'000});
  wanted.text("odom").text("base").add(1.0).add(2.0).add(3.0).add(0.0).add(0.0).add(0.0).add(1.0);
  EXPECT_EQ(bytes, wanted.bytes());
}

}  // namespace
}  // namespace zloam::ros
