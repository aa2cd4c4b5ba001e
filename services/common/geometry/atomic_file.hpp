#pragma once
// Files that are either complete or unchanged.

#include <functional>
#include <string>
#include <string_view>

namespace zloam {

/// Writes the bytes to a temporary name in the same folder (created when missing), syncs it,
/// renames it over `path` and syncs the folder. Returns an empty string, or a sentence that says
/// what failed; `path` is then untouched and no temporary file is left.
std::string write_file_atomically(const std::string& path, std::string_view bytes);
/// The same in pieces, each valid until the next one is requested; an empty one is the end. A large
/// file need never be in memory as a whole. verdict: asked behind the last piece; a sentence that
/// says why the file must not replace `path`, or an empty string.
std::string write_file_atomically(const std::string& path,
                                  const std::function<std::string_view()>& next,
                                  const std::function<std::string()>& verdict = {});

}  // namespace zloam
