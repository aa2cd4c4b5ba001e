#pragma once
// The folder of the results of one merge: it holds all of them, or nothing.

#include <filesystem>

namespace zloam::sessions {

/// Throws std::runtime_error if the folder holds something: its files could have the same names.
void refuse_filled(const std::filesystem::path& folder);

class ResultFolder {
 public:
  /// Throws as refuse_filled().
  explicit ResultFolder(std::filesystem::path folder);
  /// Without keep(), what was written is removed, and the folder if it is new.
  ~ResultFolder();
  ResultFolder(const ResultFolder&) = delete;
  ResultFolder& operator=(const ResultFolder&) = delete;

  /// Where to write: a folder within it, so that what a kill leaves is not taken for the result.
  const std::filesystem::path& path() const { return unfinished_; }
  /// Moves the files from there into the folder. Throws std::system_error.
  void keep();

 private:
  std::filesystem::path folder_, unfinished_;
  bool is_new_ = false;
  bool is_kept_ = false;
};

}  // namespace zloam::sessions
