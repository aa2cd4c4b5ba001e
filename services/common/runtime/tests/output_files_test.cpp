// Each run has its own files: they are not replaced by a shorter run's, and files of other programs
// are never replaced.

#include "common/runtime/output_files.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>

#include "common/geometry/atomic_file.hpp"
#include "common/geometry/test_file_limit.hpp"

namespace zloam::runtime {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;

constexpr const char* kList = ".runs";

struct OutputFolder : testing::Test {
  fs::path folder;

  void SetUp() override {
    const auto* info = testing::UnitTest::GetInstance()->current_test_info();
    folder = fs::temp_directory_path() /
             ("zloam-output-" + std::to_string(getpid()) + "-" + info->name());
    fs::create_directories(folder);
  }
  void TearDown() override { fs::remove_all(folder); }

  void put(const std::string& name, const std::string& text) const {
    fs::create_directories((folder / name).parent_path());
    std::ofstream(folder / name) << text;
  }
  std::string text(const std::string& name) const {
    std::ifstream file(folder / name);
    return {std::istreambuf_iterator<char>(file), {}};
  }
  /// Writes the file as a stage does at the end of a run; returns its name.
  std::string write(OutputFiles& files, const OutputFiles::Run& run,
                    const std::string& what) const {
    const std::string path = files.path("map.pcd", files.suffix(run, {"map.pcd"}));
    EXPECT_EQ(write_file_atomically(path, what), "");
    EXPECT_EQ(files.made(path, run), "");
    return fs::path(path).filename().string();
  }
};

TEST_F(OutputFolder, EachLiveRunHasItsOwn) {
  OutputFiles files(folder.string(), kList);
  EXPECT_EQ(write(files, {1, false, 120}, "one"), "map.pcd");
  EXPECT_EQ(write(files, {2, false, 3}, "two"), "map_2.pcd");
  EXPECT_EQ(write(files, {1, false, 130}, "one more"), "map.pcd");
  OutputFiles again(folder.string() + "/", kList);
  EXPECT_EQ(write(again, {2, false, 4}, "two more"), "map_2.pcd") << "of another process";
  EXPECT_EQ(write(again, {3, false, 1}, "three"), "map_3.pcd");
  EXPECT_EQ(text("map.pcd"), "one more");
}

TEST_F(OutputFolder, NothingIsReplacedByLess) {
  OutputFiles files(folder.string(), kList);
  EXPECT_EQ(write(files, {1, false, 120}, "much"), "map.pcd");
  EXPECT_EQ(write(files, {1, false, 110}, "thinned by its own process"), "map.pcd");
  OutputFiles again(folder.string(), kList);
  EXPECT_EQ(write(again, {1, false, 5}, "little"), "map_2.pcd");
  EXPECT_EQ(text("map.pcd"), "thinned by its own process");
}

// `zloam save` before the drive: its files do not take the names of those of the drive.
TEST_F(OutputFolder, WhatHoldsNothingIsReplacedByAnyRun) {
  OutputFiles files(folder.string(), kList);
  EXPECT_EQ(write(files, {0, false, 0}, "no points"), "map.pcd");
  EXPECT_EQ(write(files, {1, false, 120}, "live"), "map.pcd");
  EXPECT_EQ(write(files, {2, false, 0}, "no points"), "map_2.pcd");
  EXPECT_EQ(write(files, {3, true, 120}, "replay"), "map_2.pcd");
  EXPECT_EQ(text("map.pcd"), "live");
}

TEST_F(OutputFolder, AReplayReplacesAReplayAndNothingElse) {
  OutputFiles files(folder.string(), kList);
  EXPECT_EQ(write(files, {1, true, 120}, "a"), "map.pcd");
  OutputFiles again(folder.string(), kList);
  EXPECT_EQ(write(again, {2, true, 3}, "b"), "map.pcd");
  EXPECT_EQ(write(again, {3, false, 300}, "live"), "map_2.pcd");
  EXPECT_EQ(write(again, {4, true, 500}, "c"), "map.pcd");
  EXPECT_EQ(text("map_2.pcd"), "live");
}

TEST_F(OutputFolder, WhatOthersPutThereStays) {
  put("map.pcd", "mine");
  OutputFiles files(folder.string(), kList);
  EXPECT_EQ(write(files, {1, true, 120}, "a"), "map_2.pcd");
  EXPECT_EQ(write(files, {1, false, 120}, "a"), "map_3.pcd");
  put("map_3.pcd", "changed by somebody");
  EXPECT_EQ(write(files, {1, false, 130}, "b"), "map_4.pcd");
  EXPECT_EQ(text("map.pcd"), "mine");
  EXPECT_EQ(text("map_3.pcd"), "changed by somebody");
  for (const char* spoilt :
       {"", "{", "[]", "{\"map_4.pcd\": 1}", "{\"map_4.pcd\": {\"run\": -1}}"}) {
    put(kList, spoilt);
    EXPECT_EQ(files.suffix({1, false, 140}, {"map.pcd"}), "_5") << spoilt;
  }
}

// As on a disk that the file has filled.
TEST_F(OutputFolder, AFileOfWhichTheListCannotBeWrittenIsReplacedByTheNextAttempt) {
  OutputFiles files(folder.string(), kList);
  for (const char* what : {"a", "b", "c"}) {
    const FileLimit limit(10);
    const std::string path = files.path("map.pcd", files.suffix({1, false, 120}, {"map.pcd"}));
    EXPECT_EQ(path, (folder / "map.pcd").string()) << what;
    EXPECT_EQ(write_file_atomically(path, what), "");
    EXPECT_NE(files.made(path, {1, false, 120}), "");
  }
  EXPECT_EQ(OutputFiles(folder.string(), kList).suffix({1, false, 120}, {"map.pcd"}), "_2")
      << "another process does not know whose it is";
  EXPECT_EQ(write(files, {1, false, 120}, "d"), "map.pcd");
  EXPECT_EQ(OutputFiles(folder.string(), kList).suffix({1, false, 120}, {"map.pcd"}), "");
}

// A folder in its place fails as a disk error does.
TEST_F(OutputFolder, AListThatCannotBeReadOrNamesNoTextLosesNoFile) {
  fs::create_directories(folder / kList);
  put("map.pcd", "another's");
  OutputFiles files(folder.string(), kList);
  const std::string path = files.path("map.pcd", files.suffix({1, false, 120}, {"map.pcd"}));
  EXPECT_EQ(path, (folder / "map_2.pcd").string());
  EXPECT_EQ(write_file_atomically(path, "mine"), "");
  EXPECT_THAT(files.made(path, {1, false, 120}), HasSubstr(kList));
  EXPECT_EQ(files.suffix({1, false, 130}, {"map.pcd"}), "_2");
  fs::remove(folder / kList);
  put("stra\xdf"
      "e.pcd",
      "mine");
  EXPECT_EQ(files.made((folder / "stra\xdf"
                                 "e.pcd")
                           .string(),
                       {1, false, 120}),
            "");
}

TEST_F(OutputFolder, CommandsWriteBelowTheFolderOnly) {
  const fs::path out = folder / "out";
  fs::create_directories(out / "deep");
  put("secret", "mine");
  fs::create_directory_symlink(folder, out / "up");
  fs::create_symlink(folder / "secret", out / "link.pcd");
  const OutputFiles files(out.string(), kList);
  for (const std::string& asked :
       {std::string("../secret"), std::string("/etc/passwd"), (folder / "secret").string(),
        std::string("deep/../../secret"), std::string("."), std::string(""), std::string("deep/.."),
        out.string() + "x/a.pcd"}) {
    const auto place = files.place(asked);
    EXPECT_THAT(place.error, HasSubstr("not below the output folder")) << asked;
    EXPECT_EQ(place.path, "");
  }
  for (const char* asked : {"up/secret", "up/out/a.pcd", "link.pcd"}) {
    EXPECT_THAT(files.place(asked).error, HasSubstr("symbolic link")) << asked;
  }
  EXPECT_EQ(files.place("deep/a.pcd").path, (out / "deep/a.pcd").string());
  EXPECT_EQ(files.place((out / "./new/a.pcd").string()).path, (out / "new/a.pcd").string());
  EXPECT_THAT(OutputFiles("", kList).place("a").error, HasSubstr("no output folder"));
}

TEST_F(OutputFolder, CommandsReplaceOnlyWhatTheyMade) {
  OutputFiles files(folder.string(), kList);
  put("theirs.pcd", "theirs");
  fs::create_directory(folder / "folder");
  EXPECT_THAT(files.in_the_way((folder / "theirs.pcd").string()), HasSubstr("stays as it is"));
  EXPECT_NE(files.in_the_way((folder / "folder").string()), "");
  const std::string ours = files.place("ours.pcd").path;
  EXPECT_EQ(files.in_the_way(ours), "");
  put("ours.pcd", "ours");
  EXPECT_EQ(files.made(ours, {}), "");
  EXPECT_EQ(files.in_the_way(ours), "");
  EXPECT_EQ(OutputFiles(folder.string(), kList).in_the_way(ours), "");
}

TEST_F(OutputFolder, AFileThatIsReplacedKeepsItsMode) {
  put("map.pcd", "a");
  fs::permissions(folder / "map.pcd", fs::perms::owner_read | fs::perms::owner_write);
  EXPECT_EQ(write_file_atomically((folder / "map.pcd").string(), "b"), "");
  EXPECT_EQ(fs::status(folder / "map.pcd").permissions(),
            fs::perms::owner_read | fs::perms::owner_write);
}

}  // namespace
}  // namespace zloam::runtime
