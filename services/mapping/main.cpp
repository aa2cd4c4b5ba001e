// zloam-mapping: scan to map. Everything of substance is in mapping.hpp (the method) and
// mapping_stage.hpp (keys, answers, files).

#include <memory>

#include "common/containers/block_size.hpp"
#include "mapping/mapping_stage.hpp"

int main(int argc, char** argv) {
  zloam::mapping::MappingConfig config;
  zloam::mapping::OutputConfig output;
  std::unique_ptr<zloam::mapping::MappingStage> mapping;
  return zloam::runtime::run_stage(
      argc, argv,
      {.name = "mapping",
       .summary = "matches deskewed sweeps against a growing map and corrects the odometry",
       .bind = [&](zloam::runtime::Parameters& p) { bind(p, config, output); },
       .wire =
           [&](zloam::runtime::Stage& stage) {
             mapping = std::make_unique<zloam::mapping::MappingStage>(stage, config, output);
           },
       // A search of the whole map takes 2.6 s on two busy processors.
       .longest_work = std::chrono::milliseconds(4000),
       // The map grows while sweeps are allocated and freed: blocks kept by the heap, those of a
       // VLP-16's messages among them, would leave holes between its parts.
       .kept_block_bytes = zloam::kReturnedBlock_bytes});
}
