#pragma once
// Sets any field of the stages' configurations by name (--set key=value).

#include <string>

#include "integration/config.hpp"
#include "mapping/config.hpp"
#include "odometry/config.hpp"
#include "registration/config.hpp"

namespace zloam::offline {

struct Settings {
  registration::RegistrationConfig registration;
  odometry::OdometryConfig odometry;
  mapping::MappingConfig mapping;
  integration::IntegrationConfig integration;
};

/// Applies "stage.field=value". Throws std::invalid_argument with the reason if it is invalid.
void assign_setting(const std::string& assignment, Settings& settings);

/// All keys with their values, one per line.
std::string listing(Settings& settings);

}  // namespace zloam::offline
