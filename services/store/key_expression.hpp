#pragma once
// Whether a key expression matches a key: "*" is one chunk, "**" any number of them.

#include <string_view>

namespace zloam::store {

bool covers(std::string_view expression, std::string_view key);

}  // namespace zloam::store
