#include "sessions/result_folder.hpp"

#include <algorithm>
#include <functional>
#include <stdexcept>
#include <system_error>
#include <utility>
#include <vector>

#include "store/file.hpp"

namespace zloam::sessions {

namespace fs = std::filesystem;

namespace {

bool is_there(const fs::path& folder) { return fs::exists(fs::symlink_status(folder)); }

}  // namespace

void refuse_filled(const fs::path& folder) {
  if (!is_there(folder) || (fs::is_directory(folder) && fs::is_empty(folder))) return;
  throw std::runtime_error(folder.string() + ": exists already; name a new folder");
}

ResultFolder::ResultFolder(fs::path folder)
    : folder_(std::move(folder)), unfinished_(folder_ / "unfinished"), is_new_(!is_there(folder_)) {
  refuse_filled(folder_);
}

void ResultFolder::keep() {
  std::vector<fs::path> names;
  for (const fs::directory_entry& file : fs::directory_iterator(unfinished_)) {
    names.push_back(file.path().filename());
  }
  // The map's first file comes last: without it, those after it are reported as damaged.
  std::ranges::sort(names, std::greater<>());
  for (const fs::path& name : names) store::rename_file(unfinished_ / name, folder_ / name);
  is_kept_ = true;
  fs::remove(unfinished_);
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
    fs::remove_all(at->path(), ignored);
  }
}

}  // namespace zloam::sessions
