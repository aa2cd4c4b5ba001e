// zloam-odometer: a stage that reads poses and says how far the robot has driven. The worked example
// of docs/add-a-stage.md.

#include "common/runtime/stage.hpp"
#include "odometer/distance.hpp"

int main(int argc, char** argv) {
  using namespace zloam;
  odometer::DistanceConfig config;
  odometer::Distance distance;
  double driven_m = 0.0;
  const auto bind = [&](runtime::Parameters& p) {
    p.add("odometer.min_step_m", &config.min_step_m, {0.0, 10.0}, "m",
          "minimum distance between two poses that counts as driven");
  };
  const auto wire = [&](runtime::Stage& stage) {
    stage.on_new_run([&](const msg::Header&) { distance = {}; });
    stage.inlet<msg::MapPose>(Key::kPose, {}, [&](const runtime::Received<msg::MapPose>& pose) {
      stage.configure_for(pose);
      const Pose T_map_base = pose_of(pose->pose_map_base());
      driven_m = distance.add(T_map_base.translation(), config);
      stage.figure("driven_m", driven_m);
    });
    stage.on_end_of_run([&](std::uint64_t) {
      runtime::log_info("the robot has driven", {{"driven_m", driven_m}});
    });
  };
  return runtime::run_stage(argc, argv,
                            {.name = "odometer",
                             .summary = "Says how far the robot has driven.",
                             .bind = bind,
                             .wire = wire});
}
