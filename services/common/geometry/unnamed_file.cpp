#include "common/geometry/unnamed_file.hpp"

#include <fcntl.h>
#include <unistd.h>

#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <system_error>
#include <utility>

namespace zloam {

UnnamedFile::~UnnamedFile() {
  if (descriptor_ >= 0) ::close(descriptor_);
}

UnnamedFile::UnnamedFile(UnnamedFile&& other) noexcept
    : folder_(std::move(other.folder_)),
      descriptor_(std::exchange(other.descriptor_, -1)),
      size_(other.size_),
      failed_(other.failed_) {}

UnnamedFile& UnnamedFile::operator=(UnnamedFile&& other) noexcept {
  folder_ = std::move(other.folder_);
  std::swap(descriptor_, other.descriptor_);
  size_ = other.size_;
  failed_ = other.failed_;
  return *this;
}

void UnnamedFile::create() {
  std::error_code ignored;
  std::filesystem::create_directories(folder_, ignored);
  std::string name = folder_ + "/zloam.XXXXXX";
  descriptor_ = mkstemp(name.data());
  if (descriptor_ >= 0) std::remove(name.c_str());
  failed_ = descriptor_ < 0;
}

std::optional<std::int64_t> UnnamedFile::append(std::span<const std::byte> bytes) {
  if (descriptor_ < 0 && !failed_) create();
  const std::int64_t begin = size_;
  while (!failed_ && !bytes.empty()) {
    const ::ssize_t written = ::pwrite(descriptor_, bytes.data(), bytes.size(), size_);
    failed_ = written <= 0;
    if (failed_) break;
    size_ += written;
    bytes = bytes.subspan(static_cast<std::size_t>(written));
  }
  if (failed_) return std::nullopt;
  return begin;
}

void UnnamedFile::release(std::int64_t offset, std::int64_t bytes) {
  if (descriptor_ < 0 || bytes <= 0) return;
  ::fallocate(descriptor_, FALLOC_FL_PUNCH_HOLE | FALLOC_FL_KEEP_SIZE, offset, bytes);
}

bool UnnamedFile::read(std::int64_t offset, std::span<std::byte> bytes) const {
  while (!bytes.empty()) {
    const ::ssize_t got = ::pread(descriptor_, bytes.data(), bytes.size(), offset);
    if (got <= 0) return false;
    offset += got;
    bytes = bytes.subspan(static_cast<std::size_t>(got));
  }
  return true;
}

}  // namespace zloam
