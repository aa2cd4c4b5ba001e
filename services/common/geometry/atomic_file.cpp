#include "common/geometry/atomic_file.hpp"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <system_error>
#include <utility>

#include "common/geometry/write_all.hpp"

namespace zloam {
namespace {

std::string failure(const std::string& what, const std::string& path) {
  return what + " " + path + ": " + std::strerror(errno);
}

bool write_pieces(int descriptor, const std::function<std::string_view()>& next) {
  for (std::string_view piece = next(); !piece.empty(); piece = next()) {
    if (!write_all(descriptor, piece)) return false;
  }
  return true;
}

/// Mode of the new file: that of the file it replaces, else 0644.
mode_t mode_of(const std::string& path) {
  struct stat about {};
  const bool is_file = ::lstat(path.c_str(), &about) == 0 && S_ISREG(about.st_mode);
  return is_file ? about.st_mode & 07777 : 0644;
}

/// Makes a file in the folder, and the folder if it is missing. -1: `reason` says why not.
int create_in(const std::filesystem::path& folder, std::string& name, std::string& reason) {
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  const std::string path = name;
  name += ".XXXXXX";
  const int descriptor = ::mkostemp(name.data(), O_CLOEXEC);
  if (descriptor >= 0) return descriptor;
  // Of a folder that could not be made, errno only says that it is not there.
  reason = error ? "cannot create the folder " + folder.string() + ": " + error.message()
                 : failure("cannot create a file beside", path);
  return -1;
}

void sync_folder(const std::filesystem::path& folder) {
  const int descriptor = ::open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (descriptor < 0) return;
  ::fsync(descriptor);
  ::close(descriptor);
}

}  // namespace

std::string write_file_atomically(const std::string& path, std::string_view bytes) {
  return write_file_atomically(path, [&] { return std::exchange(bytes, {}); });
}

std::string write_file_atomically(const std::string& path,
                                  const std::function<std::string_view()>& next,
                                  const std::function<std::string()>& verdict) {
  std::filesystem::path folder = std::filesystem::path(path).parent_path();
  if (folder.empty()) folder = ".";
  std::string temporary = path, reason;
  const int descriptor = create_in(folder, temporary, reason);
  if (descriptor < 0) return reason;
  ::fchmod(descriptor, mode_of(path));
  bool good = write_pieces(descriptor, next) && ::fsync(descriptor) == 0;
  if (!good) reason = failure("cannot write", path);
  if (good && verdict) {
    reason = verdict();
    good = reason.empty();
  }
  if (::close(descriptor) != 0 && good) {
    good = false;
    reason = failure("cannot close", path);
  }
  if (good && ::rename(temporary.c_str(), path.c_str()) != 0) {
    good = false;
    reason = failure("cannot rename to", path);
  }
  if (!good) ::unlink(temporary.c_str());
  if (good) sync_folder(folder);
  return reason;
}

}  // namespace zloam
