#include "mapping/method.hpp"

#include <stdexcept>

#include "mapping/loam_method.hpp"
#include "mapping/voxel_planes_method.hpp"

namespace zloam::mapping {

std::vector<std::string> method_names() { return {kLoam, kVoxelPlanes}; }

std::unique_ptr<MappingMethod> make_method(const MappingConfig& config) {
  if (config.method == kLoam) return make_loam_method(config);
  if (config.method == kVoxelPlanes) return make_voxel_planes_method(config);
  std::string allowed;
  for (const std::string& name : method_names()) allowed += " " + name;
  throw std::invalid_argument("mapping.method: '" + config.method +
                              "' is unknown; allowed:" + allowed);
}

}  // namespace zloam::mapping
