#pragma once
// Velodyne's entry in the list of makers.

#include <memory>
#include <string>
#include <vector>

#include "driver/decoder/maker.hpp"

namespace zloam::driver::velodyne {

/// Labels of the models that are decoded.
std::vector<std::string> models();

std::unique_ptr<const Maker> make(const DecodingOptions& options);

}  // namespace zloam::driver::velodyne
