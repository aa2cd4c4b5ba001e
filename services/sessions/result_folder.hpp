#pragma once
// The folder of the results of one merge: it holds all of them, or nothing.

#include <filesystem>

namespace zloam::sessions {

class ResultFolder {
 public:
  /// Throws std::runtime_error if the folder holds something: its files could have the same names.
  explicit ResultFolder(std::filesystem::path folder);
  /// Without keep(), what was written into the folder is removed, and the folder if it is new.
  ~ResultFolder();
  ResultFolder(const ResultFolder&) = delete;
  ResultFolder& operator=(const ResultFolder&) = delete;

  const std::filesystem::path& path() const { return folder_; }
  void keep() { is_kept_ = true; }

 private:
  std::filesystem::path folder_;
  bool is_new_ = false;
  bool is_kept_ = false;
};

}  // namespace zloam::sessions
