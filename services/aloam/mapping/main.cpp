// zloam-aloam-mapping: A-LOAM's mapping in place of mapping. The method is in core/scan_to_map.hpp.

#include <memory>

#include "aloam/mapping/mapping_stage.hpp"

int main(int argc, char** argv) {
  using namespace zloam;
  aloam::AloamConfig config;
  aloam::OutputConfig output;
  std::unique_ptr<aloam::MappingStage> mapping;
  return runtime::run_stage(
      argc, argv,
      {.name = "mapping",
       .variant = aloam::kVariant,
       .summary = "matches each sweep against a map of edge and plane points, as A-LOAM does",
       .bind =
           [&](runtime::Parameters& p) {
             bind(p, config);
             bind(p, output);
           },
       .wire =
           [&](runtime::Stage& stage) {
             mapping = std::make_unique<aloam::MappingStage>(stage, output);
           }});
}
