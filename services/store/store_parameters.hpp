#pragma once
#include "common/runtime/parameters.hpp"
#include "store/config.hpp"

namespace zloam::store {

void bind(runtime::Parameters& parameters, StoreConfig& config);

}  // namespace zloam::store
