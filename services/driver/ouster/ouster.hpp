#pragma once
// Ouster, for the list of makers.

#include <memory>
#include <string>
#include <vector>

#include "driver/decoder/maker.hpp"

namespace zloam::driver::ouster {

/// None: the metadata say which it is.
std::vector<std::string> models();

std::unique_ptr<const Maker> make(const DecodingOptions& options);

}  // namespace zloam::driver::ouster
