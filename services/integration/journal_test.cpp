#include "integration/journal.hpp"

#include <gtest/gtest.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>

#include "common/geometry/test_file_limit.hpp"

namespace zloam::integration {
namespace {

class JournalTest : public ::testing::Test {
 protected:
  void SetUp() override {
    folder_ = std::filesystem::temp_directory_path() / ("journal" + std::to_string(::getpid()));
    std::filesystem::create_directories(folder_);
    path_ = (folder_ / "sub" / "run.journal").string();
  }
  void TearDown() override { std::filesystem::remove_all(folder_); }

  std::filesystem::path folder_;
  std::string path_;
};

JournalPose pose(std::uint64_t sweep) {
  JournalPose p;
  p.run = 0xfedcba9876543210U;
  p.sweep = sweep;
  p.odom_epoch = 3;
  p.instant_ns = 1'700'000'000'123'456'789 + static_cast<std::int64_t>(sweep);
  Vector6 motion;
  motion << 0.1, -0.2, 0.3, 0.4, 0.5, -0.6;
  p.T_map_base = exp_se3(static_cast<double>(sweep + 1) / 3.0 * motion);
  p.T_odom_base = p.T_map_base.inverse();
  p.replay = sweep % 2 == 1;
  return p;
}

void expect_equal(const JournalPose& a, const JournalPose& b) {
  EXPECT_EQ(a.run, b.run);
  EXPECT_EQ(a.sweep, b.sweep);
  EXPECT_EQ(a.instant_ns, b.instant_ns);
  EXPECT_EQ(a.odom_epoch, b.odom_epoch);
  EXPECT_EQ(a.T_map_base.matrix(), b.T_map_base.matrix());
  EXPECT_EQ(a.T_odom_base.matrix(), b.T_odom_base.matrix());
  EXPECT_EQ(a.replay, b.replay);
}

TEST_F(JournalTest, GivesBackToTheBitWhatAProcessBeforeWrote) {
  {
    Journal journal(path_);
    ASSERT_EQ(journal.begin({pose(0)}), "");
    for (std::uint64_t i = 1; i < 5; ++i) ASSERT_EQ(journal.append(pose(i)), "");
  }
  const auto poses = Journal(path_).read();
  ASSERT_EQ(poses.size(), 5U);
  for (std::uint64_t i = 0; i < 5; ++i) expect_equal(poses[i], pose(i));
}

TEST_F(JournalTest, CutAtAnyByteItHoldsTheRecordsBefore) {
  {
    Journal journal(path_);
    ASSERT_EQ(journal.begin({pose(0), pose(1), pose(2)}), "");
  }
  const auto size = std::filesystem::file_size(path_);
  const auto record = size / 3;
  for (auto cut = size; cut-- > 0;) {
    std::filesystem::resize_file(path_, cut);
    const auto poses = Journal(path_).read();
    ASSERT_EQ(poses.size(), cut / record) << cut;
    for (std::size_t i = 0; i < poses.size(); ++i) expect_equal(poses[i], pose(i));
  }
}

// The size of a file may reach the disk before its contents.
TEST_F(JournalTest, TheZerosThatAPowerFailureLeavesAreNoPoses) {
  {
    Journal journal(path_);
    ASSERT_EQ(journal.begin({pose(0), pose(1), pose(2)}), "");
  }
  const auto size = std::filesystem::file_size(path_);
  for (const std::uintmax_t kept : {3U, 2U, 1U, 0U}) {
    // Sets to zero what comes after.
    std::filesystem::resize_file(path_, kept * size / 3);
    std::filesystem::resize_file(path_, 2 * size);
    const auto poses = Journal(path_).read();
    ASSERT_EQ(poses.size(), kept);
    for (std::size_t i = 0; i < poses.size(); ++i) expect_equal(poses[i], pose(i));
  }
}

TEST_F(JournalTest, ADamagedByteEndsIt) {
  {
    Journal journal(path_);
    ASSERT_EQ(journal.begin({pose(0), pose(1), pose(2)}), "");
  }
  const auto record = std::filesystem::file_size(path_) / 3;
  for (std::uintmax_t at = record; at < 2 * record; ++at) {
    const auto flip = [&] {
      std::fstream file(path_, std::ios::in | std::ios::out | std::ios::binary);
      file.seekg(static_cast<std::streamoff>(at));
      const char byte = static_cast<char>(file.get() ^ 0x40);
      file.seekp(static_cast<std::streamoff>(at));
      file.put(byte);
    };
    flip();
    EXPECT_EQ(Journal(path_).read().size(), 1U) << at;
    flip();
    EXPECT_EQ(Journal(path_).read().size(), 3U) << at;
  }
}

// As one of a version with other records.
TEST_F(JournalTest, OneThatCannotBeReadIsKept) {
  const auto text_of = [](const std::string& path) {
    std::ifstream file(path, std::ios::binary);
    return std::string(std::istreambuf_iterator<char>(file), {});
  };
  Journal journal(path_);
  EXPECT_EQ(journal.keep_unread(), "");
  for (const char* name : {".unread", ".2.unread"}) {
    ASSERT_EQ(journal.begin({pose(0), pose(1)}), "");
    EXPECT_EQ(journal.keep_unread(), "") << "it can be read";
    const std::string other = name + text_of(path_);
    std::ofstream(path_, std::ios::binary) << other;
    EXPECT_EQ(journal.keep_unread(), path_ + name);
    ASSERT_EQ(journal.begin({}), "");
    EXPECT_EQ(journal.keep_unread(), "") << "there is nothing in it";
    EXPECT_EQ(text_of(path_ + name), other);
  }
}

// As on a full disk, on which the trajectory finds no room, but an empty journal does.
TEST_F(JournalTest, OneWhosePosesCouldNotBeWrittenOutlivesTheNextRun) {
  Journal journal(path_);
  EXPECT_EQ(journal.keep_unwritten(), "") << "there is none";
  for (const char* ending : {".unwritten", ".2.unwritten"}) {
    ASSERT_EQ(journal.begin({pose(0)}), "");
    ASSERT_EQ(journal.append(pose(2)), "");
    EXPECT_EQ(journal.keep_unwritten(), path_ + ending);
    ASSERT_EQ(journal.begin({}), "");
    EXPECT_EQ(journal.keep_unwritten(), "") << "there is nothing in it";
    EXPECT_EQ(Journal(path_ + ending).read().size(), 2U);
  }
}

// Its poses would be dropped at the next start anyway, and each attempt would add another journal.
TEST_F(JournalTest, OneOfAReplayIsNotKeptBecauseItCanBeRepeated) {
  Journal journal(path_);
  ASSERT_TRUE(pose(1).replay);
  ASSERT_EQ(journal.begin({pose(1)}), "");
  EXPECT_EQ(journal.keep_unwritten(), "");
  EXPECT_EQ(journal.read().size(), 1U);
}

TEST_F(JournalTest, BeginningAnewForgetsAndRemovingLeavesNothing) {
  Journal journal(path_);
  ASSERT_EQ(journal.begin({pose(0), pose(1)}), "");
  ASSERT_EQ(journal.begin({pose(7)}), "");
  ASSERT_EQ(journal.append(pose(8)), "");
  ASSERT_EQ(journal.read().size(), 2U);
  expect_equal(journal.read()[0], pose(7));
  journal.remove();
  EXPECT_TRUE(journal.read().empty());
  EXPECT_TRUE(std::filesystem::is_empty(folder_ / "sub"));
}

// A live driver that starts again soon begins another run, whose sweeps count from 0, in the same
// journal.
TEST(DropAfter, OnlyLaterPosesOfTheLastRunAreDropped) {
  std::vector<JournalPose> poses;
  for (std::uint64_t sweep = 0; sweep < 10; ++sweep) poses.push_back(pose(sweep));
  const std::uint64_t first_run = poses.front().run;
  for (std::uint64_t sweep = 0; sweep < 5; ++sweep) {
    poses.push_back(pose(sweep));
    poses.back().run = first_run + 1;
  }
  const std::vector<JournalPose> all = poses;
  ASSERT_TRUE(drop_after(poses, first_run + 1, 3));
  ASSERT_EQ(poses.size(), 14U);
  for (std::size_t i = 0; i < poses.size(); ++i) expect_equal(poses[i], all[i]);
  EXPECT_FALSE(drop_after(poses, first_run + 1, 4)) << "a pose that the journal lacks";
  EXPECT_FALSE(drop_after(poses, first_run + 2, 3)) << "a run that the journal lacks";
  EXPECT_EQ(poses.size(), 14U);
}

// The first part of the record still finds room.
TEST_F(JournalTest, AFullDiskIsNamedAndWhatWasWrittenBeforeIsLeft) {
  Journal journal(path_);
  ASSERT_EQ(journal.begin({pose(0)}), "");
  const FileLimit limit(3 * std::filesystem::file_size(path_) / 2);
  errno = 0;
  EXPECT_EQ(journal.append(pose(1)), path_ + ": " + std::strerror(EFBIG));
  EXPECT_EQ(journal.append(pose(2)), "") << "said once";
  EXPECT_EQ(journal.read().size(), 1U);
}

TEST_F(JournalTest, WhenThereIsRoomAgainItHoldsAllPoses) {
  Journal journal(path_);
  ASSERT_EQ(journal.begin({pose(0)}), "");
  {
    const FileLimit limit(3 * std::filesystem::file_size(path_) / 2);
    EXPECT_NE(journal.append(pose(1)), "");
    EXPECT_EQ(journal.append(pose(2)), "");
    EXPECT_TRUE(journal.is_behind());
  }
  EXPECT_EQ(journal.append(pose(3)), "");
  EXPECT_FALSE(journal.is_behind());
  const auto poses = journal.read();
  ASSERT_EQ(poses.size(), 4U);
  for (std::size_t i = 0; i < poses.size(); ++i) expect_equal(poses[i], pose(i));
}

TEST_F(JournalTest, OneThatIsKeptHasAllPosesIfThereIsRoomByThen) {
  Journal journal(path_);
  std::vector<JournalPose> live = {pose(0), pose(1)};
  for (JournalPose& each : live) each.replay = false;
  ASSERT_EQ(journal.begin({live[0]}), "");
  {
    const FileLimit limit(3 * std::filesystem::file_size(path_) / 2);
    EXPECT_NE(journal.append(live[1]), "");
  }
  const std::string kept = journal.keep_unwritten();
  EXPECT_EQ(Journal(kept).read().size(), 2U);
}

TEST_F(JournalTest, ANewOneThatFindsNoRoomLeavesTheOldOneAndNothingElse) {
  Journal journal(path_);
  ASSERT_EQ(journal.begin({pose(0)}), "");
  {
    const FileLimit limit(3 * std::filesystem::file_size(path_) / 2);
    EXPECT_EQ(journal.begin({pose(1), pose(2)}), path_ + ": " + std::strerror(EFBIG));
  }
  ASSERT_EQ(journal.read().size(), 1U);
  expect_equal(journal.read()[0], pose(0));
  EXPECT_FALSE(std::filesystem::exists(path_ + ".new"));
}

TEST_F(JournalTest, WithoutAPathNothingIsKept) {
  Journal journal("");
  EXPECT_EQ(journal.begin({pose(0)}), "");
  EXPECT_EQ(journal.append(pose(1)), "");
  EXPECT_TRUE(journal.read().empty());
}

TEST_F(JournalTest, AFolderThatCannotBeMadeIsSaid) {
  Journal journal("/proc/nowhere/run.journal");
  EXPECT_NE(journal.begin({}), "");
  std::ofstream(folder_ / "file") << "x";
  const std::string missing = (folder_ / "file" / "sub").string();
  EXPECT_EQ(Journal(missing + "/run.journal").begin({}), missing + ": Not a directory");
}

}  // namespace
}  // namespace zloam::integration
