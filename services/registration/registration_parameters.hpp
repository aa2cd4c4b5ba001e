#pragma once
// Names, ranges and meaning of registration's parameters.

#include "registration/config.hpp"
#include "registration/sharing.hpp"

namespace zloam::runtime {
class Parameters;
}

namespace zloam::registration {

void bind(runtime::Parameters& parameters, RegistrationConfig& config);
void bind(runtime::Parameters& parameters, SharingConfig& config);

}  // namespace zloam::registration
