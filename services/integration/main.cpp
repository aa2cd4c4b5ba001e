// zloam-integration: poses at sensor rate from odometry and the map's corrections. Everything of
// substance is in integration.hpp (the method) and integration_stage.hpp (keys, files).

#include <memory>

#include "integration/integration_stage.hpp"

int main(int argc, char** argv) {
  zloam::integration::IntegrationConfig config;
  std::unique_ptr<zloam::integration::IntegrationStage> integration;
  return zloam::runtime::run_stage(
      argc, argv,
      {.name = "integration",
       .summary = "fuses odometry with the map's corrections, writes the trajectory",
       .bind = [&](zloam::runtime::Parameters& p) { bind(p, config); },
       .wire =
           [&](zloam::runtime::Stage& stage) {
             integration = std::make_unique<zloam::integration::IntegrationStage>(stage, config);
           }});
}
