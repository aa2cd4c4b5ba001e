#pragma once
// LOAM's own matching: each edge and plane feature against the line or plane through its nearest
// map points (Zhang and Singh, RSS 2014, sections V and VI).

#include "mapping/method.hpp"

namespace zloam::mapping {

std::unique_ptr<MappingMethod> make_loam_method(const MappingConfig& config);

}  // namespace zloam::mapping
