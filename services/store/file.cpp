#include "store/file.hpp"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <csignal>
#include <string_view>
#include <system_error>
#include <utility>

#include "common/geometry/write_all.hpp"

namespace zloam::store {
namespace {

namespace fs = std::filesystem;

std::uint64_t changes_done = 0;
std::uint64_t change_to_die_at = 0;

[[noreturn]] void fail(const std::string& what, const fs::path& path) {
  throw std::system_error(errno, std::generic_category(), what + " " + path.string());
}

/// Counts one change of the disk; true: die_at_change() named this one.
bool last_change() { return ++changes_done == change_to_die_at; }

void die() { ::raise(SIGKILL); }

void write_or_fail(int descriptor, std::span<const std::uint8_t> bytes, const fs::path& path) {
  const std::string_view text(reinterpret_cast<const char*>(bytes.data()), bytes.size());
  if (!write_all(descriptor, text)) fail("can't write", path);
}

}  // namespace

void die_at_change(std::uint64_t n) {
  changes_done = 0;
  change_to_die_at = n;
}

std::uint64_t changes() { return changes_done; }

AppendFile::AppendFile(const fs::path& path) : path_(path) {
  if (last_change()) die();
  descriptor_ = ::open(path.c_str(), O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0644);
  if (descriptor_ < 0) fail("can't open", path);
  const off_t end = ::lseek(descriptor_, 0, SEEK_END);
  size_ = end > 0 ? static_cast<std::uint64_t>(end) : 0;
}

AppendFile::~AppendFile() { close(); }

AppendFile::AppendFile(AppendFile&& other) noexcept
    : descriptor_(std::exchange(other.descriptor_, -1)),
      torn_(other.torn_),
      size_(other.size_),
      path_(std::move(other.path_)) {}

AppendFile& AppendFile::operator=(AppendFile&& other) noexcept {
  if (this != &other) {
    close();
    descriptor_ = std::exchange(other.descriptor_, -1);
    torn_ = other.torn_;
    size_ = other.size_;
    path_ = std::move(other.path_);
  }
  return *this;
}

void AppendFile::append(std::span<const std::uint8_t> bytes) {
  cut();
  if (last_change()) {
    write_or_fail(descriptor_, bytes.first(bytes.size() / 2), path_);
    die();
  }
  try {
    write_or_fail(descriptor_, bytes, path_);
  } catch (const std::system_error&) {
    // As on a full disk: records behind a half-written one could not be read.
    torn_ = ::ftruncate(descriptor_, static_cast<off_t>(size_)) != 0;
    throw;
  }
  size_ += bytes.size();
}

void AppendFile::cut() {
  if (torn_ && ::ftruncate(descriptor_, static_cast<off_t>(size_)) != 0) fail("can't cut", path_);
  torn_ = false;
}

void AppendFile::sync() {
  if (last_change()) die();
  if (::fsync(descriptor_) != 0) fail("can't sync", path_);
}

void AppendFile::close() {
  if (descriptor_ >= 0) ::close(descriptor_);
  descriptor_ = -1;
}

FolderLock::FolderLock(const fs::path& folder) {
  descriptor_ = ::open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (descriptor_ < 0) fail("can't open", folder);
  if (::flock(descriptor_, LOCK_EX | LOCK_NB) == 0) return;
  const int error = errno;
  ::close(descriptor_);
  errno = error;
  if (error == EWOULDBLOCK) {
    throw std::system_error(std::make_error_code(std::errc::device_or_resource_busy),
                            folder.string() + " is in use by another store");
  }
  fail("can't lock", folder);
}

FolderLock::~FolderLock() { ::close(descriptor_); }

ReadFile::ReadFile(const fs::path& path) : path_(path) {
  descriptor_ = ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
  if (descriptor_ < 0) fail("can't read", path);
}

ReadFile::~ReadFile() {
  if (descriptor_ >= 0) ::close(descriptor_);
}

ReadFile::ReadFile(ReadFile&& other) noexcept
    : descriptor_(std::exchange(other.descriptor_, -1)), path_(std::move(other.path_)) {}

std::vector<std::uint8_t> ReadFile::all() const {
  struct stat about {};
  if (::fstat(descriptor_, &about) != 0) fail("can't read", path_);
  return part(0, static_cast<std::size_t>(about.st_size));
}

std::vector<std::uint8_t> ReadFile::part(std::uint64_t offset, std::size_t size) const {
  std::vector<std::uint8_t> bytes(size);
  std::size_t done = 0;
  while (done < size) {
    const ssize_t n =
        ::pread(descriptor_, bytes.data() + done, size - done, static_cast<off_t>(offset + done));
    if (n < 0 && errno == EINTR) continue;
    if (n == 0) errno = EIO;
    if (n <= 0) fail("can't read", path_);
    done += static_cast<std::size_t>(n);
  }
  return bytes;
}

bool may_have_room(const fs::space_info& space, std::uint64_t bytes) {
  // A tmpfs without a limit, and many FUSE file systems, report zeros.
  if (space.capacity == 0) return true;
  // The reserve is for root only.
  return (::geteuid() == 0 ? space.free : space.available) >= bytes;
}

void truncate_file(const fs::path& path, std::uint64_t size) {
  if (last_change()) die();
  if (::truncate(path.c_str(), static_cast<off_t>(size)) != 0) fail("can't cut", path);
}

void link_file(const fs::path& from, const fs::path& to) {
  if (last_change()) die();
  if (::link(from.c_str(), to.c_str()) != 0) fail("can't link", from);
}

void rename_file(const fs::path& from, const fs::path& to) {
  if (last_change()) die();
  if (::rename(from.c_str(), to.c_str()) != 0) fail("can't rename to", to);
  sync_folder(to.parent_path());
}

void remove_file(const fs::path& path) {
  if (last_change()) die();
  if (::unlink(path.c_str()) != 0 && errno != ENOENT) fail("can't remove", path);
}

void sync_folder(const fs::path& folder) {
  if (last_change()) die();
  const int descriptor = ::open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (descriptor < 0) fail("can't open", folder);
  const int result = ::fsync(descriptor);
  ::close(descriptor);
  if (result != 0) fail("can't sync", folder);
}

}  // namespace zloam::store
