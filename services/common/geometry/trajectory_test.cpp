#include "common/geometry/trajectory.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <cstring>
#include <sstream>

namespace zloam {
namespace {

std::string whole(const Trajectory& poses, TrajectoryText::Line line) {
  TrajectoryText text(poses, line);
  std::string all;
  for (std::string_view piece = text.next(); !piece.empty(); piece = text.next()) all += piece;
  return all;
}

std::string tum_text(const Trajectory& poses) { return whole(poses, tum_line); }
std::string kitti_text(const Trajectory& poses) { return whole(poses, kitti_line); }

TEST(TrajectoryText, TumByHand) {
  const Trajectory poses = {
      {1'700'000'000'123'456'789, Pose::Identity()},
      {1'700'000'000'223'456'789, pose_from_xyz_rpy_deg({1.5, -2.25, 0.125}, {0, 0, 90})},
  };
  EXPECT_EQ(tum_text(poses),
            "1700000000.123456789 0.000000000 0.000000000 0.000000000 "
            "0.000000000 0.000000000 0.000000000 1.000000000\n"
            "1700000000.223456789 1.500000000 -2.250000000 0.125000000 "
            "0.000000000 0.000000000 0.707106781 0.707106781\n");
}

TEST(TrajectoryText, StampsKeepTheirNanoseconds) {
  EXPECT_EQ(tum_text(Trajectory{{5, Pose::Identity()}}).substr(0, 11), "0.000000005");
  EXPECT_EQ(tum_text(Trajectory{{-1, Pose::Identity()}}).substr(0, 12), "-0.000000001");
}

TEST(TrajectoryText, TumReadsBack) {
  Trajectory poses;
  for (int i = 0; i < 50; ++i) {
    Vector6 twist;
    twist << 3.0 * i, -i, 0.1 * i, 0.05 * i, -0.02 * i, 0.06 * i;
    poses.push_back({i * 100'000'000LL, exp_se3(twist)});
  }
  std::istringstream text(tum_text(poses));
  for (const TrajectoryPose& pose : poses) {
    double stamp, x, y, z, qx, qy, qz, qw;
    ASSERT_TRUE(text >> stamp >> x >> y >> z >> qx >> qy >> qz >> qw);
    EXPECT_NEAR(stamp, 1e-9 * static_cast<double>(pose.instant_ns), 1e-9);
    EXPECT_LT((Eigen::Vector3d(x, y, z) - pose.T_parent_base.translation()).norm(), 2e-9);
    const Eigen::Matrix3d rotation = Eigen::Quaterniond(qw, qx, qy, qz).toRotationMatrix();
    EXPECT_LT((rotation - pose.T_parent_base.linear()).norm(), 1e-8);
    EXPECT_GE(qw, 0.0);
  }
}

TEST(TrajectoryText, MorePosesThanOnePieceHolds) {
  Trajectory poses;
  std::string lines;
  for (int i = 0; i < 3000; ++i) {
    poses.push_back({i, Pose::Identity()});
    lines += tum_line(poses.back());
  }
  EXPECT_EQ(tum_text(poses), lines);
}

TEST(TrajectoryText, KittiIsTheUpperThreeRows) {
  const Trajectory poses = {{0, pose_from_xyz_rpy_deg({1, 2, 3}, {0, 0, 90})}};
  std::istringstream text(kitti_text(poses));
  const double expected[12] = {0, -1, 0, 1, 1, 0, 0, 2, 0, 0, 1, 3};
  for (const double value : expected) {
    double read = 99.0;
    ASSERT_TRUE(text >> read);
    EXPECT_NEAR(read, value, 1e-9);
  }
  EXPECT_EQ(kitti_text(poses).back(), '\n');
  EXPECT_EQ(kitti_text({}), "");
}

TEST(TrajectoryText, DigitsAreThoseOfPrintf) {
  for (const double value :
       {0.1, -0.0, 1e-10, -4.5e-10, 5e-10, 123456.7890123456, -1e300, 2.5e-9}) {
    Pose pose = Pose::Identity();
    pose.translation().x() = value;
    char wanted[400];
    std::snprintf(wanted, sizeof wanted, "%.9f ", value == 0.0 ? 0.0 : value);
    EXPECT_EQ(tum_text({{0, pose}}).substr(12, std::strlen(wanted)), wanted);
  }
}

}  // namespace
}  // namespace zloam
