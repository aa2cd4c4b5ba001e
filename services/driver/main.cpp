// zloam-driver: converts packets of a sensor, a capture or stored scans to sweeps. The work is done
// in decoder/ and the makers' folders, sweep/ and scan/ (the method), io/ (sources) and
// driver_stage.hpp (keys, pacing).

#include <memory>

#include "driver/driver_stage.hpp"

int main(int argc, char** argv) {
  zloam::driver::DriverConfig config;
  std::unique_ptr<zloam::driver::DriverStage> driver;
  return zloam::runtime::run_stage(
      argc, argv,
      {.name = "driver",
       .summary = "receives or replays lidar packets and cuts them into sweeps",
       .bind = [&](zloam::runtime::Parameters& p) { bind(p, config); },
       .wire =
           [&](zloam::runtime::Stage& stage) {
             driver = std::make_unique<zloam::driver::DriverStage>(stage, config);
           }});
}
