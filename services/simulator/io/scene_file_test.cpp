#include "simulator/io/scene_file.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

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

TEST_F(SceneFile, NamesFileLineAndKeyOfWhatIsWrong) {
  using testing::AllOf;
  using testing::HasSubstr;
  EXPECT_EQ(refusal(kPath), "accepted");
  EXPECT_THAT(refusal(std::string(kPath) + "drive: {max_sped: 3}\n"),
              AllOf(HasSubstr(".yaml"), HasSubstr("line 2"), HasSubstr("max_sped")));
  EXPECT_THAT(refusal(std::string(kPath) + "shapes:\n  - {kind: cone, centre: [0, 0, 0]}\n"),
              AllOf(HasSubstr("line 3"), HasSubstr("cone")));
  EXPECT_THAT(refusal(std::string(kPath) + "shapes:\n  - {kind: box, centre: [0, 0, 0]}\n"),
              HasSubstr("'size' is missing"));
  EXPECT_THAT(refusal(std::string(kPath) + "drive: {height_m: high}\n"), HasSubstr("a number"));
  EXPECT_THAT(refusal(std::string(kPath) + "drive: {max_speed_m_s: 0}\n"), HasSubstr("above 0"));
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
