#include "sessions/result_folder.hpp"

#include <stdexcept>
#include <system_error>
#include <utility>

namespace zloam::sessions {

namespace fs = std::filesystem;

ResultFolder::ResultFolder(fs::path folder)
    : folder_(std::move(folder)), is_new_(!fs::exists(fs::symlink_status(folder_))) {
  if (is_new_ || (fs::is_directory(folder_) && fs::is_empty(folder_))) return;
  throw std::runtime_error(folder_.string() + ": exists already; name a new folder");
}

ResultFolder::~ResultFolder() {
  if (is_kept_) return;
  std::error_code ignored;
  if (is_new_) {
    fs::remove_all(folder_, ignored);
    return;
  }
  // No exception may leave a destructor.
  for (fs::directory_iterator at(folder_, ignored); at != fs::directory_iterator();
       at.increment(ignored)) {
    fs::remove(at->path(), ignored);
  }
}

}  // namespace zloam::sessions
