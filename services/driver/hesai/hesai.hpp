#pragma once
// Hesai's entry in the list of makers.

#include <memory>
#include <string>
#include <vector>

#include "driver/decoder/maker.hpp"

namespace zloam::driver::hesai {

/// As on the sensors' labels.
std::vector<std::string> models();

std::unique_ptr<const Maker> make(const DecodingOptions& options);

}  // namespace zloam::driver::hesai
