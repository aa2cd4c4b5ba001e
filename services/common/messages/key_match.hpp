#pragma once
// Whether a key expression matches a key: '*' is any one chunk, '**' any number of them.

#include <string_view>

namespace zloam {

bool key_matches(std::string_view expression, std::string_view key);

}  // namespace zloam
