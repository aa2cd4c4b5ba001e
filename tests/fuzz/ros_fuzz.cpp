// Decodes the messages that a ROS node sends (Imu, pose), and checks names that a user configures.

#include <cmath>
#include <cstdlib>
#include <string_view>

#include "ros/cdr.hpp"
#include "ros/graph.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (const auto reading = zloam::ros::decode_imu({data, size})) {
    if (!reading->force_mps2.allFinite() || !reading->rate_radps.allFinite()) std::abort();
  }
  if (const auto place = zloam::ros::decode_place({data, size})) {
    if (!(std::isfinite(place->x_m + place->y_m + place->yaw_rad))) std::abort();
  }
  const std::string_view name(reinterpret_cast<const char*>(data), size);
  // An accepted name must not split a token or match other keys than itself.
  const bool passes = zloam::ros::name_error(name).empty();
  if (passes && name.find_first_of("*$#?%@ ") != std::string_view::npos) std::abort();
  return 0;
}
