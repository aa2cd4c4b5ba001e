// zloam-aloam-odometry: A-LOAM's odometry in place of odometry. The method is in
// core/scan_to_scan.hpp.

#include <memory>

#include "aloam/odometry/odometry_stage.hpp"

int main(int argc, char** argv) {
  using namespace zloam;
  aloam::AloamConfig config;
  std::unique_ptr<aloam::OdometryStage> odometry;
  return runtime::run_stage(argc, argv,
                            {.name = "odometry",
                             .variant = aloam::kVariant,
                             .summary = "estimates the motion from sweep to sweep, as A-LOAM does",
                             .bind = [&](runtime::Parameters& p) { bind(p, config); },
                             .wire =
                                 [&](runtime::Stage& stage) {
                                   odometry = std::make_unique<aloam::OdometryStage>(stage, config);
                                 }});
}
