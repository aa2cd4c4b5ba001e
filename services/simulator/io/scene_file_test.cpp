#include "simulator/io/scene_file.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <stdexcept>
#include <string>

namespace zloam::simulator {
namespace {

class SceneFile : public testing::Test {
 protected:
  std::string written(const std::string& text) {
    std::ofstream(path_) << text;
    return path_;
  }
  std::string refusal(const std::string& text) {
    try {
      read_scene(written(text), {});
    } catch (const std::invalid_argument& error) {
      return error.what();
    }
    return "accepted";
  }
  ~SceneFile() override { std::filesystem::remove(path_); }

 private:
  std::string path_ = testing::TempDir() + "scene_" +
                      testing::UnitTest::GetInstance()->current_test_info()->name() + ".yaml";
};

const char* const kPath = "path: {points: [[0, 0], [30, 0]]}\n";

TEST_F(SceneFile, GivesTheWorldThatItDescribes) {
  const auto scene = read_scene(written(R"(
path: {points: [[0, 0], [20, 0], [20, 20], [-20, 20], [-20, 0]], closed: true, corner_radius_m: 4}
drive: {max_speed_m_s: 2, height_m: 1.5, roll_deg: 0, pitch_deg: 0, bob_m: 0}
ground: {low: [-50, -50], high: [50, 50], spacing_m: 5}
shapes:
  - {kind: box, centre: [30, 0, 2], size: [2, 4, 4], rpy_deg: [0, 0, 90], reflectivity: 80}
  - {kind: cylinder, centre: [0, -5, 2], size: [1, 1, 4]}
)"),
                                {});
  const Eigen::Vector3d eye(0.0, 0.0, 1.5);
  const Hit box = scene->world.cast({eye, Eigen::Vector3d::UnitX()}, 100.0);
  EXPECT_NEAR(box.range_m, 28.0, 1e-9);
  EXPECT_EQ(box.reflectivity, 80.0);
  EXPECT_NEAR(scene->world.cast({eye, -Eigen::Vector3d::UnitY()}, 100.0).range_m, 4.5, 1e-9);
  EXPECT_NEAR(scene->world.cast({eye, -Eigen::Vector3d::UnitZ()}, 100.0).range_m, 1.5, 1e-6);
  const Pose start = scene->trajectory.at(0.0).T_world_body;
  EXPECT_TRUE(start.translation().isApprox(eye, 1e-6));
  const Pose end = scene->trajectory.at(scene->trajectory.duration_s()).T_world_body;
  EXPECT_LT((end.translation() - start.translation()).norm(), 0.05);
}

TEST_F(SceneFile, WhatMovesFollowsItsPoints) {
  const auto scene = read_scene(written(std::string(kPath) + R"(
movers:
  - points: [[10, -20], [10, 20]]
    speed_m_s: 5
    start_m: 5
    repeat: to_and_fro
    shapes: [{kind: box, centre: [0, 0, 1], size: [4, 2, 2]}]
)"),
                                {});
  const auto moving = scene->world.moving_at(2.0);
  ASSERT_EQ(moving.size(), 1U);
  EXPECT_TRUE(moving[0].shape.centre.isApprox(Eigen::Vector3d(10.0, -5.0, 1.0), 1e-9));
  EXPECT_TRUE(moving[0].velocity.isApprox(Eigen::Vector3d(0.0, 5.0, 0.0), 1e-9));
  const Eigen::Vector3d eye(0.0, -5.0, 1.0);
  const Hit hit = scene->world.cast({eye, Eigen::Vector3d::UnitX()}, 100.0, moving);
  EXPECT_NEAR(hit.range_m, 9.0, 1e-9) << "it has turned towards where it goes";
  EXPECT_EQ(hit.surface, 0);
}

// In the frame of the first pose of base_link, all walls, the floor and the ceiling of this world
// lie on cell boundaries of a map with cells of 0.25, 0.5 or 1 m.
TEST_F(SceneFile, TheGridWorldsWallsStandOnTheGrid) {
  const auto scene = read_scene(ZLOAM_WORLDS "/grid.yaml", {});
  const Pose T_map_world = scene->trajectory.at(0.0).T_world_body.inverse();
  ASSERT_GT(scene->world.shapes().size(), 8U);
  int faces = 0;
  for (const Shape& shape : scene->world.shapes()) {
    for (int axis = 0; axis < 3; ++axis) {
      for (const double side : {-1.0, 1.0}) {
        const Eigen::Vector3d face =
            T_map_world *
            Eigen::Vector3d(shape.centre + side * shape.half[axis] * Eigen::Vector3d::Unit(axis));
        EXPECT_NEAR(face[axis], std::round(face[axis]), 1e-6);
        ++faces;
      }
    }
  }
  EXPECT_GT(faces, 48);
}

TEST_F(SceneFile, NamesFileLineAndKeyOfWhatIsWrong) {
  using testing::AllOf;
  using testing::HasSubstr;
  EXPECT_EQ(refusal(kPath), "accepted");
  EXPECT_THAT(refusal(std::string(kPath) + "drive: {max_sped: 3}\n"),
              AllOf(HasSubstr(".yaml"), HasSubstr("line 2"), HasSubstr("max_sped")));
  EXPECT_THAT(refusal(std::string(kPath) + "drive: {? [bob_m, laps] : 3}\n"),
              AllOf(HasSubstr(".yaml"), HasSubstr("line 2"), HasSubstr("[bob_m, laps]")));
  EXPECT_THAT(refusal(std::string(kPath) + "shapes:\n  - {kind: cone, centre: [0, 0, 0]}\n"),
              AllOf(HasSubstr("line 3"), HasSubstr("cone")));
  EXPECT_THAT(refusal(std::string(kPath) + "shapes:\n  - {kind: box, centre: [0, 0, 0]}\n"),
              HasSubstr("'size' is missing"));
  EXPECT_THAT(refusal(std::string(kPath) + "drive: {height_m: high}\n"), HasSubstr("a number"));
  EXPECT_THAT(refusal(std::string(kPath) + "drive: {max_speed_m_s: 0}\n"), HasSubstr("above 0"));
  const std::string mover = std::string(kPath) + "movers: [{points: [[0, 0], [1, 0]], shapes: []";
  EXPECT_THAT(refusal(mover + "}]"), HasSubstr("'speed_m_s' is missing"));
  EXPECT_THAT(refusal(mover + ", speed_m_s: -1}]"), HasSubstr("speed above 0"));
  EXPECT_THAT(refusal(mover + ", speed_m_s: 1, repeat: often}]"), HasSubstr("often"));
  EXPECT_THAT(refusal(mover + ", speed_m_s: 1, colour: red}]"), HasSubstr("colour"));
  EXPECT_THAT(refusal("shapes: []\n"), HasSubstr("'path' is missing"));
  EXPECT_THAT(refusal("path: {points: [[0, 0]]}\n"), HasSubstr("too few"));
  EXPECT_THAT(refusal("path: {points: [[0, 0], [9, .nan]]}\n"), HasSubstr("a number"));
  EXPECT_THAT(refusal("path: {points: [[0, 0], [9, 0], [9, 1], [0, 1]]}\n"),
              HasSubstr("corner radius"));
  EXPECT_THAT(refusal("path: [\n"), HasSubstr(".yaml"));
  EXPECT_THROW(read_scene("/nonexistent.yaml", {}), std::invalid_argument);
}

}  // namespace
}  // namespace zloam::simulator
