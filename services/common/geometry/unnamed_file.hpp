#pragma once
// A file that no other program sees: for data that a program would otherwise hold in memory.

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>

namespace zloam {

/// It never has a name, so it disappears with the process, however that ends. Nothing is created
/// before the first append.
class UnnamedFile {
 public:
  /// folder: on the file system that provides the space; created when missing.
  explicit UnnamedFile(std::string folder) : folder_(std::move(folder)) {}
  ~UnnamedFile();
  UnnamedFile(UnnamedFile&& other) noexcept;
  UnnamedFile& operator=(UnnamedFile&& other) noexcept;

  /// Offset of the bytes; nothing: writing failed, and no more bytes can be written.
  std::optional<std::int64_t> append(std::span<const std::byte> bytes);
  /// Gives the room of whole blocks in this range back, if the file system can: they read as zeros.
  void release(std::int64_t offset, std::int64_t bytes);
  /// False: some of the bytes could not be read.
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
