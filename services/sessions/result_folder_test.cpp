#include "sessions/result_folder.hpp"

#include <gtest/gtest.h>

#include <cstdlib>
#include <fstream>
#include <stdexcept>
#include <string>

#include "common/geometry/test_folder.hpp"

namespace zloam::sessions {
namespace {

namespace fs = std::filesystem;

class ResultFolderTest : public InFolder {
 protected:
  /// Writes a file of a merge into the folder.
  static void write(const ResultFolder& out) {
    fs::create_directories(out.path());
    std::ofstream(out.path() / "graph.g2o") << "graph";
  }
};

TEST_F(ResultFolderTest, OfAFailureNothingIsLeftAndTheFolderCanBeNamedAgain) {
  const fs::path missing = folder_ / "missing", empty = folder_ / "empty";
  fs::create_directory(empty);
  for (const fs::path& folder : {missing, empty}) {
    write(ResultFolder(folder));
    EXPECT_EQ(fs::exists(folder), folder == empty);
    ResultFolder again(folder);
    write(again);
    again.keep();
  }
  for (const fs::path& folder : {missing, empty}) {
    EXPECT_TRUE(fs::exists(folder / "graph.g2o"));
  }
}

// A kill may come at any time before keep().
TEST_F(ResultFolderTest, FilesHaveTheirNamesOnceAllAreWritten) {
  const fs::path folder = folder_ / "week";
  ResultFolder out(folder);
  write(out);
  EXPECT_FALSE(fs::exists(folder / "graph.g2o"));
  out.keep();
  EXPECT_TRUE(fs::exists(folder / "graph.g2o"));
  EXPECT_FALSE(fs::exists(out.path()));
}

TEST_F(ResultFolderTest, FilesOfOthersStay) {
  std::ofstream(folder_ / "map.pcd") << "mine";
  EXPECT_THROW(ResultFolder out(folder_), std::runtime_error);
  EXPECT_THROW(ResultFolder out(folder_ / "map.pcd"), std::runtime_error);
  EXPECT_TRUE(fs::exists(folder_ / "map.pcd"));
}

// As one to a disk that is not mounted.
TEST_F(ResultFolderTest, ALinkThatLeadsNowhereStays) {
  const fs::path link = folder_ / "link";
  fs::create_symlink(folder_ / "nowhere", link);
  EXPECT_THROW(ResultFolder out(link), std::runtime_error);
  EXPECT_TRUE(fs::is_symlink(link));
}

}  // namespace
}  // namespace zloam::sessions
