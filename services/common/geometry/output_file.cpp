#include "common/geometry/output_file.hpp"

#include <cerrno>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <stdexcept>
#include <system_error>

namespace zloam {
namespace {

/// A symbolic link stays, and its file is replaced, as that of a redirected /dev/stdout.
std::string target_of(const std::string& path) {
  std::error_code error;
  const std::filesystem::path target = std::filesystem::canonical(path, error);
  return error ? path : target.string();
}

/// A device or a pipe is written as it is: as root, the rename would put a file in the place of
/// /dev/null. So is a file that has no name, to which /dev/stdout may lead.
std::string temporary_of(const std::string& path) {
  std::error_code error;
  const auto status = std::filesystem::status(path, error);
  // target_of() leaves a link only if its target has no name.
  const bool has_name = !std::filesystem::is_symlink(path, error);
  const bool is_special = std::filesystem::exists(status) && !(is_regular_file(status) && has_name);
  return is_special ? path : path + ".part";
}

}  // namespace

OutputFile::OutputFile(const std::string& path)
    : path_(target_of(path)),
      temporary_(temporary_of(path_)),
      stream_(temporary_, std::ios::binary | std::ios::trunc) {
  if (!stream_) {
    throw std::runtime_error("cannot write " + path_ + ": " + std::strerror(errno));
  }
}

OutputFile::~OutputFile() {
  if (is_whole_ || temporary_ == path_) return;
  stream_.close();
  std::remove(temporary_.c_str());
}

void OutputFile::write(const void* data, std::size_t size) {
  if (!stream_.write(static_cast<const char*>(data), static_cast<std::streamsize>(size))) {
    throw std::runtime_error("cannot write " + path_ + ": " + std::strerror(errno));
  }
}

void OutputFile::close() {
  stream_.close();
  if (!stream_ || (temporary_ != path_ && std::rename(temporary_.c_str(), path_.c_str()) != 0)) {
    throw std::runtime_error("cannot write " + path_ + ": " + std::strerror(errno));
  }
  is_whole_ = true;
}

}  // namespace zloam
