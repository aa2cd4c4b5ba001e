#include "integration/state_file.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <filesystem>
#include <fstream>

#include "common/geometry/test_file_limit.hpp"

namespace zloam::integration {
namespace {

class StateFileTest : public ::testing::Test {
 protected:
  void SetUp() override {
    folder_ = std::filesystem::temp_directory_path() / ("state" + std::to_string(::getpid()));
    std::filesystem::create_directories(folder_);
    path_ = (folder_ / "run.state").string();
  }
  void TearDown() override { std::filesystem::remove_all(folder_); }

  std::filesystem::path folder_;
  std::string path_;
};

SavedState state(std::uint64_t sweep) { return {7, sweep, {sweep, 3 * sweep, ~sweep}}; }

TEST_F(StateFileTest, GivesBackTheNewestThatIsOfNoLaterPose) {
  StateFile file(path_);
  ASSERT_EQ(file.begin(), "");
  for (std::uint64_t sweep = 0; sweep < 5; ++sweep) ASSERT_EQ(file.write(state(sweep)), "");
  const StateFile other(path_);
  ASSERT_TRUE(other.read(7, 9).has_value());
  EXPECT_EQ(other.read(7, 9)->sweep, 4U);
  EXPECT_EQ(other.read(7, 9)->words, state(4).words);
  EXPECT_EQ(other.read(7, 3)->sweep, 3U);
  EXPECT_FALSE(other.read(7, 2).has_value());
  EXPECT_FALSE(other.read(8, 9).has_value()) << "of another run";
}

TEST_F(StateFileTest, CutOrChangedAtAnyByteTheOneBeforeIsLeft) {
  {
    StateFile file(path_);
    ASSERT_EQ(file.begin(), "");
    ASSERT_EQ(file.write(state(0)), "");
    ASSERT_EQ(file.write(state(1)), "");
  }
  const std::string newest = path_ + ".1";
  const auto size = std::filesystem::file_size(newest);
  std::string whole(size, '\0');
  std::ifstream(newest, std::ios::binary).read(whole.data(), static_cast<std::streamsize>(size));
  const auto put = [&](const std::string& bytes) {
    std::ofstream(newest, std::ios::binary | std::ios::trunc) << bytes;
  };
  for (std::size_t i = 0; i < size; ++i) {
    put(whole.substr(0, i));
    ASSERT_EQ(StateFile(path_).read(7, 9)->sweep, 0U) << "cut at " << i;
    std::string changed = whole;
    changed[i] = static_cast<char>(changed[i] ^ 1);
    put(changed);
    ASSERT_EQ(StateFile(path_).read(7, 9)->sweep, 0U) << "changed at " << i;
  }
  put(whole);
  EXPECT_EQ(StateFile(path_).read(7, 9)->sweep, 1U);
}

TEST_F(StateFileTest, WhoHasTheOldFilesOpenWritesToNobody) {
  StateFile overtaken(path_);
  ASSERT_EQ(overtaken.begin(), "");
  ASSERT_EQ(overtaken.write(state(5)), "");
  StateFile file(path_);
  ASSERT_EQ(file.begin(), "");
  ASSERT_EQ(file.write(state(6)), "");
  ASSERT_EQ(overtaken.write(state(7)), "");
  EXPECT_EQ(file.read(7, 9)->sweep, 6U);
  file.remove();
  EXPECT_TRUE(std::filesystem::is_empty(folder_));
}

// The first part of the state still finds room.
TEST_F(StateFileTest, AFullDiskIsNamedAndTheOneBeforeIsLeft) {
  StateFile file(path_);
  ASSERT_EQ(file.begin(), "");
  ASSERT_EQ(file.write(state(0)), "");
  const FileLimit limit(std::filesystem::file_size(path_ + ".0") - 1);
  errno = 0;
  EXPECT_EQ(file.write(state(1)), path_ + ".1: " + std::strerror(EFBIG));
  EXPECT_EQ(file.read(7, 9)->sweep, 0U);
}

TEST_F(StateFileTest, WhenThereIsRoomAgainTheNextOneIsKept) {
  StateFile file(path_);
  ASSERT_EQ(file.begin(), "");
  ASSERT_EQ(file.write(state(0)), "");
  {
    const FileLimit limit(std::filesystem::file_size(path_ + ".0") - 1);
    EXPECT_NE(file.write(state(1)), "");
    EXPECT_NE(file.write(state(2)), "") << "as long as it lasts";
    EXPECT_EQ(file.read(7, 9)->sweep, 0U);
  }
  EXPECT_EQ(file.write(state(3)), "");
  EXPECT_EQ(file.read(7, 9)->sweep, 3U);
  EXPECT_EQ(file.read(7, 2)->sweep, 0U);
}

TEST_F(StateFileTest, WithoutAPathNothingIsKeptAndAFolderThatIsNotThereIsSaid) {
  StateFile none("");
  EXPECT_EQ(none.begin(), "");
  EXPECT_EQ(none.write(state(0)), "");
  EXPECT_FALSE(none.read(7, 9).has_value());
  EXPECT_NE(StateFile("/proc/nowhere/run.state").begin(), "");
}

}  // namespace
}  // namespace zloam::integration
