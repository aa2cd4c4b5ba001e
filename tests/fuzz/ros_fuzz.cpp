// What a ROS node sends: an Imu's bytes, and names that a user writes.

#include <cstdlib>
#include <string_view>

#include "ros/cdr.hpp"
#include "ros/graph.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (const auto reading = zloam::ros::decode_imu({data, size})) {
    if (!reading->force_mps2.allFinite() || !reading->rate_radps.allFinite()) std::abort();
  }
  const std::string_view name(reinterpret_cast<const char*>(data), size);
  // What passes must not part a token or match more than itself.
  const bool passes = zloam::ros::name_error(name).empty();
  if (passes && name.find_first_of("*$#?%@ ") != std::string_view::npos) std::abort();
  return 0;
}
