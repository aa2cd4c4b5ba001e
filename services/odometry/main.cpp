// zloam-odometry: the motion from sweep to sweep. Everything of substance is in odometry.hpp (the
// method) and odometry_stage.hpp (keys, answers).

#include <memory>

#include "odometry/odometry_parameters.hpp"
#include "odometry/odometry_stage.hpp"

int main(int argc, char** argv) {
  zloam::odometry::OdometryConfig config;
  std::unique_ptr<zloam::odometry::OdometryStage> odometry;
  return zloam::runtime::run_stage(
      argc, argv,
      {.name = "odometry",
       .summary = "estimates the motion from sweep to sweep and deskews each sweep to one instant",
       .bind = [&](zloam::runtime::Parameters& p) { bind(p, config); },
       .wire =
           [&](zloam::runtime::Stage& stage) {
             odometry = std::make_unique<zloam::odometry::OdometryStage>(stage, config);
           }});
}
