#pragma once
// A file that nobody else sees: for what a program would otherwise hold in memory.

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>

namespace zloam {

/// It has no name from the start, so it goes with the process, however that ends. Nothing is
/// created before the first append.
class UnnamedFile {
 public:
  /// folder: on the file system that gives the room; created when it is missing.
  explicit UnnamedFile(std::string folder) : folder_(std::move(folder)) {}
  ~UnnamedFile();
  UnnamedFile(UnnamedFile&& other) noexcept;
  UnnamedFile& operator=(UnnamedFile&& other) noexcept;

  /// Where the bytes begin; none: they could not be written, and none can be any more.
  std::optional<std::int64_t> append(std::span<const std::byte> bytes);
  /// False: they are not all there.
  bool read(std::int64_t offset, std::span<std::byte> bytes) const;
  bool failed() const { return failed_; }

 private:
  void create();

  std::string folder_;
  int descriptor_ = -1;
  std::int64_t size_ = 0;
  bool failed_ = false;
};

}  // namespace zloam
