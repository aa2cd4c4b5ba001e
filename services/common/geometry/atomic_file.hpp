#pragma once
// Files that are either whole or as they were before.

#include <string>
#include <string_view>

namespace zloam {

/// Writes the bytes to a temporary name in the same folder (created when missing), syncs it,
/// renames it over `path` and syncs the folder. Returns an empty string, or a sentence that says
/// what failed; `path` is then untouched and no temporary file is left.
std::string write_file_atomically(const std::string& path, std::string_view bytes);

}  // namespace zloam
