#pragma once
// A folder of a test's own.

#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <string>

namespace zloam {

/// Base of tests that write files: folder_ is empty at first, and removed at the end.
class InFolder : public testing::Test {
 protected:
  InFolder() {
    std::string name = (std::filesystem::temp_directory_path() / "zloam-test-XXXXXX").string();
    folder_ = mkdtemp(name.data());
  }
  ~InFolder() override { std::filesystem::remove_all(folder_); }
  std::filesystem::path folder_;
};

}  // namespace zloam
