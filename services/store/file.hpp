#pragma once
// A file that is only ever appended to, and the few operations on folders that must not be lost at
// a power failure. Every operation that changes the disk is counted, so that a test can end the
// process in the middle of any of them.

#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <vector>

namespace zloam::store {

/// The process ends itself by SIGKILL at the n-th change of the disk from 1; a write is then half
/// done. 0: never. Also set by the environment, ZLOAM_FAULT_STORE_WRITE, in the program.
void die_at_change(std::uint64_t n);
/// Changes so far.
std::uint64_t changes();

/// Throws std::system_error with the path when something fails.
class AppendFile {
 public:
  AppendFile() = default;
  /// Creates the file, or opens it and goes to its end.
  explicit AppendFile(const std::filesystem::path& path);
  ~AppendFile();
  AppendFile(AppendFile&& other) noexcept;
  AppendFile& operator=(AppendFile&& other) noexcept;

  bool is_open() const { return descriptor_ >= 0; }
  std::uint64_t size() const { return size_; }
  /// All bytes, or none: what a failed attempt leaves is cut off, at the latest by the next one.
  void append(std::span<const std::uint8_t> bytes);
  /// Cuts off what a failed append() left.
  void cut();
  void sync();
  void close();

 private:
  int descriptor_ = -1;
  /// bytes of a failed append() lie behind size_
  bool torn_ = false;
  std::uint64_t size_ = 0;
  std::filesystem::path path_;
};

/// A file open for reading: its content stays readable when another process removes it.
class ReadFile {
 public:
  /// Throws std::system_error with the path.
  explicit ReadFile(const std::filesystem::path& path);
  ~ReadFile();
  ReadFile(ReadFile&& other) noexcept;
  ReadFile& operator=(ReadFile&&) = delete;

  std::vector<std::uint8_t> all() const;
  /// Bytes [offset, offset + size); throws when some are missing.
  std::vector<std::uint8_t> part(std::uint64_t offset, std::size_t size) const;

 private:
  int descriptor_ = -1;
  std::filesystem::path path_;
};

/// A folder locked against other processes; released with the process, however that ends.
/// Throws std::system_error when another has it.
class FolderLock {
 public:
  explicit FolderLock(const std::filesystem::path& folder);
  ~FolderLock();
  FolderLock(const FolderLock&) = delete;
  FolderLock& operator=(const FolderLock&) = delete;

 private:
  int descriptor_ = -1;
};

/// False: a file system that reports its size has less room than these bytes.
bool may_have_room(const std::filesystem::space_info& space, std::uint64_t bytes);

void truncate_file(const std::filesystem::path& path, std::uint64_t size);
/// Gives the file a second name (a hard link) on the same file system.
void link_file(const std::filesystem::path& from, const std::filesystem::path& to);
/// Renames within a folder, and syncs the folder.
void rename_file(const std::filesystem::path& from, const std::filesystem::path& to);
void remove_file(const std::filesystem::path& path);
void sync_folder(const std::filesystem::path& folder);

}  // namespace zloam::store
