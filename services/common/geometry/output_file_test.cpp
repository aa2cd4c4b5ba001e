#include "common/geometry/output_file.hpp"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <iterator>
#include <stdexcept>

#include "common/geometry/test_file_limit.hpp"
#include "common/geometry/test_folder.hpp"

namespace zloam {
namespace {

namespace fs = std::filesystem;

class OutputFileTest : public InFolder {
 protected:
  OutputFileTest() { path_ = (folder_ / "out.csv").string(); }

  std::string text() const {
    std::ifstream file(path_);
    return {std::istreambuf_iterator<char>(file), {}};
  }

  std::string path_;
};

TEST_F(OutputFileTest, AppearsWhenItIsCompleteAndReplacesOneBefore) {
  for (const std::string said : {"first", "second"}) {
    const std::string before = text();
    OutputFile file(path_);
    file.write(said);
    EXPECT_EQ(text(), before);
    file.close();
    EXPECT_EQ(text(), said);
  }
  OutputFile(path_).write("never closed");
  EXPECT_EQ(text(), "second");
  EXPECT_EQ(std::distance(fs::directory_iterator(folder_), {}), 1);
}

// The last bytes are written, and find no room, only at the end.
TEST_F(OutputFileTest, ADiskThatIsFullAtTheEndIsNamedAndGetsItsRoomBack) {
  OutputFile(path_).close();
  {
    OutputFile file(path_);
    const FileLimit limit(500);
    file.write(std::string(900, 'x'));
    EXPECT_THROW(file.close(), std::runtime_error);
  }
  EXPECT_EQ(text(), "");
  EXPECT_EQ(std::distance(fs::directory_iterator(folder_), {}), 1);
}

// As root, /dev/null would become a file.
TEST_F(OutputFileTest, APipeOrADeviceStays) {
  ASSERT_EQ(::mkfifo(path_.c_str(), 0600), 0);
  const int reader = ::open(path_.c_str(), O_RDONLY | O_NONBLOCK | O_CLOEXEC);
  OutputFile pipe(path_);
  pipe.write("through");
  pipe.close();
  char got[16]{};
  EXPECT_EQ(::read(reader, got, sizeof got), 7);
  EXPECT_STREQ(got, "through");
  ::close(reader);
  EXPECT_TRUE(fs::is_fifo(path_));
  fs::create_symlink("/dev/full", folder_ / "link");
  {
    OutputFile device((folder_ / "link").string());
    device.write("lost");
    EXPECT_THROW(device.close(), std::runtime_error);
  }
  EXPECT_TRUE(fs::is_symlink(folder_ / "link"));
  EXPECT_TRUE(fs::is_character_file("/dev/full"));
  EXPECT_THROW(OutputFile folder(folder_.string()), std::runtime_error);
}

// As /dev/stdout is one.
TEST_F(OutputFileTest, ALinkStaysAndItsFileIsReplaced) {
  OutputFile(path_).close();
  fs::create_symlink(path_, folder_ / "link");
  OutputFile file((folder_ / "link").string());
  file.write("linked");
  file.close();
  EXPECT_EQ(text(), "linked");
  EXPECT_TRUE(fs::is_symlink(folder_ / "link"));
}

// As /dev/stdout of a program whose output goes to a temporary file: as root, /dev/stdout itself
// would be replaced.
TEST_F(OutputFileTest, ALinkToAFileWithoutANameStays) {
  const int unnamed = ::open(path_.c_str(), O_CREAT | O_RDWR | O_CLOEXEC, 0600);
  ASSERT_GE(unnamed, 0);
  fs::remove(path_);
  const fs::path link = folder_ / "link";
  fs::create_symlink("/proc/self/fd/" + std::to_string(unnamed), link);
  OutputFile file(link.string());
  file.write("through");
  file.close();
  char got[16]{};
  EXPECT_EQ(::pread(unnamed, got, sizeof got, 0), 7);
  EXPECT_STREQ(got, "through");
  ::close(unnamed);
  EXPECT_TRUE(fs::is_symlink(link));
  EXPECT_EQ(std::distance(fs::directory_iterator(folder_), {}), 1);
}

}  // namespace
}  // namespace zloam
