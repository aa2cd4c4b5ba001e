#include "common/geometry/atomic_file.hpp"

#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>

#include "common/geometry/test_file_limit.hpp"
#include "common/geometry/test_folder.hpp"

namespace zloam {
namespace {

namespace fs = std::filesystem;

class AtomicFile : public InFolder {
 protected:
};

TEST_F(AtomicFile, AFolderThatCannotBeMadeIsNamedWithItsReason) {
  std::ofstream(folder_ / "file") << "x";
  const fs::path missing = folder_ / "file" / "sub";
  EXPECT_EQ(write_file_atomically((missing / "map.pcd").string(), "map"),
            "cannot create the folder " + missing.string() + ": Not a directory");
  EXPECT_EQ(write_file_atomically((folder_ / "a" / "b" / "map.pcd").string(), "map"), "");
}

TEST_F(AtomicFile, OnAFullDiskTheFileBeforeStaysAndNothingElse) {
  const std::string path = (folder_ / "map.pcd").string();
  ASSERT_EQ(write_file_atomically(path, "earlier"), "");
  {
    const FileLimit limit(100);
    EXPECT_EQ(write_file_atomically(path, std::string(1000, 'x')),
              "cannot write " + path + ": File too large");
  }
  std::ifstream file(path);
  EXPECT_EQ(std::string(std::istreambuf_iterator<char>(file), {}), "earlier");
  EXPECT_EQ(std::distance(fs::directory_iterator(folder_), {}), 1);
}

}  // namespace
}  // namespace zloam
