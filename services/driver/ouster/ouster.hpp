#pragma once
// Ouster's entry in the list of makers.

#include <memory>
#include <string>
#include <vector>

#include "driver/decoder/maker.hpp"

namespace zloam::driver::ouster {

/// Empty: the metadata contain the model.
std::vector<std::string> models();

std::unique_ptr<const Maker> make(const DecodingOptions& options);

}  // namespace zloam::driver::ouster
