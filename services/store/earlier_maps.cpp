#include "store/earlier_maps.hpp"

#include <algorithm>
#include <charconv>
#include <cstdint>
#include <iterator>
#include <map>
#include <string>
#include <string_view>
#include <system_error>

#include "store/file.hpp"

namespace zloam::store {
namespace {

namespace fs = std::filesystem;
constexpr std::string_view kName = "earlier-";
// A folder that is not complete yet, or half removed. A kill leaves it; the next map removes it.
constexpr const char* kTemporary = "earlier.tmp";

/// All that is named earlier-<n>, by number.
std::map<std::uint64_t, fs::path> numbered(const fs::path& folder) {
  std::map<std::uint64_t, fs::path> found;
  for (const auto& entry : fs::directory_iterator(folder)) {
    const std::string name = entry.path().filename().string();
    if (!name.starts_with(kName)) continue;
    std::uint32_t n = 0;
    const char* const last = name.data() + name.size();
    const auto [end, error] = std::from_chars(name.data() + kName.size(), last, n);
    if (error == std::errc{} && end == last) found.emplace(n, entry.path());
  }
  return found;
}

/// Whether the folder was made of these very files, and holds nothing else.
bool is_made_of(const fs::path& folder, const std::vector<fs::path>& files) {
  std::error_code none;
  const auto count = std::distance(fs::directory_iterator(folder, none), fs::directory_iterator());
  return count == std::ssize(files) && std::ranges::all_of(files, [&](const fs::path& file) {
           std::error_code missing;
           return fs::equivalent(folder / file.filename(), file, missing);
         });
}

}  // namespace

std::optional<fs::path> keep_earlier_map(const fs::path& folder,
                                         const std::vector<fs::path>& files) {
  if (files.empty()) {
    throw std::system_error(std::make_error_code(std::errc::no_such_file_or_directory),
                            "the files of the map in " + folder.string());
  }
  const std::map<std::uint64_t, fs::path> others = numbered(folder);
  // The new map may be begun several times, on a full disk or because of a kill.
  if (!others.empty() && is_made_of(others.rbegin()->second, files)) return std::nullopt;
  const std::uint64_t number = others.empty() ? 1 : others.rbegin()->first + 1;
  const fs::path begun = folder / kTemporary;
  const fs::path kept = folder / (std::string(kName) + std::to_string(number));
  fs::remove_all(begun);
  fs::create_directory(begun);
  try {
    for (const fs::path& file : files) link_file(file, begun / file.filename());
    sync_folder(begun);
    rename_file(begun, kept);
  } catch (const std::system_error&) {
    std::error_code left;
    fs::remove_all(begun, left);
    throw;
  }
  return kept;
}

std::optional<fs::path> remove_oldest_map(const fs::path& folder) {
  std::map<std::uint64_t, fs::path> maps = numbered(folder);
  std::erase_if(maps, [](const auto& map) { return !fs::is_directory(map.second); });
  if (maps.size() <= kEarlierMaps) return std::nullopt;
  const fs::path& oldest = maps.begin()->second;
  const FolderLock lock(oldest);
  // Renamed first, so that no part of a map passes for a map.
  fs::remove_all(folder / kTemporary);
  rename_file(oldest, folder / kTemporary);
  fs::remove_all(folder / kTemporary);
  return oldest;
}

}  // namespace zloam::store
