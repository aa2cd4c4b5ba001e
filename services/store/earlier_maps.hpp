#pragma once
// The maps that others replaced: each in a folder earlier-<n> beside the store's files, made of hard
// links to them. That costs neither time nor room, because a closed file never changes; once the
// store has compacted, the links alone hold the earlier map. Greater numbers are later maps.

#include <cstddef>
#include <filesystem>
#include <optional>
#include <vector>

namespace zloam::store {

/// A robot that nobody looks after must not fill its disk.
inline constexpr std::size_t kEarlierMaps = 3;

/// Links these closed files into the next earlier-<n>, which is complete or not there; nothing: the
/// newest one has these files already. Throws std::system_error when it can't be made.
std::optional<std::filesystem::path> keep_earlier_map(
    const std::filesystem::path& folder, const std::vector<std::filesystem::path>& files);

/// Removes the oldest earlier-<n> if there are more than kEarlierMaps, and returns its name. Throws
/// std::system_error when it can't be removed, or another store uses it.
std::optional<std::filesystem::path> remove_oldest_map(const std::filesystem::path& folder);

}  // namespace zloam::store
