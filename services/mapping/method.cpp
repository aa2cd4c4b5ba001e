#include "mapping/method.hpp"

#include <stdexcept>

#include "mapping/loam_method.hpp"

namespace zloam::mapping {

std::unique_ptr<MappingMethod> make_method(const MappingConfig& config) {
  if (config.method == "loam") return make_loam_method(config);
  throw std::invalid_argument("mapping.method: '" + config.method + "' is unknown; allowed: loam");
}

}  // namespace zloam::mapping
