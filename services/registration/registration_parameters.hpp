#pragma once
// Names, ranges and meaning of what can be configured about registration.

#include "registration/config.hpp"

namespace zloam::runtime {
class Parameters;
}

namespace zloam::registration {

void bind(runtime::Parameters& parameters, RegistrationConfig& config);

}  // namespace zloam::registration
