#include "aloam/registration/registration_stage.hpp"

#include "aloam/core/scan_registration.hpp"
#include "common/runtime/replicas.hpp"

namespace zloam::aloam {
namespace {

// From the data sheets of VLP-16 and HDL-64E; only stages other than A-LOAM's use it.
constexpr float kRangeNoise_m = 0.02F;

FeaturesFields fields_of(const msg::Sweep& sweep, const ScanFeatures& features) {
  FeaturesFields f;
  f.period_ns = sweep.period_ns();
  f.rings = sweep.rings();
  f.slices = sweep.slices();
  f.sharp = features.sharp;
  f.less_sharp = features.less_sharp;
  f.flat = features.flat;
  f.less_flat = features.less_flat;
  f.points_in = sweep.points() == nullptr ? 0 : sweep.points()->size();
  f.points_rejected = features.rejected;
  f.deskewed = sweep.deskewed();
  f.health = features.less_flat.empty() ? Health::kEmpty : health_of(sweep.health());
  f.range_noise_m = kRangeNoise_m;
  f.imu = structs_of(sweep.imu());
  return f;
}

}  // namespace

RegistrationStage::RegistrationStage(runtime::Stage& stage)
    : stage_(stage),
      defaults_(defaults_of(stage.shared().sensor.model)),
      features_(stage.outlet(Key::kFeatures)) {
  runtime::InletOptions options;
  options.on_given_up = [this](std::uint64_t run, std::uint64_t sweep, std::string_view) {
    publish_dropped(run, sweep);
  };
  sweeps_ = &stage.inlet<msg::Sweep>(Key::kSweep, options,
                                     [this](const Sweep& sweep) { process(sweep); });
}

void RegistrationStage::process(const Sweep& sweep) {
  stage_.configure_for(sweep);
  stage_.degraded("rings", rings_error(sweep->rings(), sweep->slices()));
  const ScanFeatures found =
      extract_features(points_of(sweep->points()), defaults_.min_range_m, defaults_.elevations,
                       sweep->rings(), has_one_return(*sweep));
  const HeaderFields header = features_.header(sweep);
  features_.publish(header, build(header, fields_of(*sweep, found)));
  last_ = header;
  stage_.figure("points_in", sweep->points() == nullptr ? 0.0 : sweep->points()->size());
}

void RegistrationStage::publish_dropped(std::uint64_t run, std::uint64_t sweep) {
  runtime::publish_dropped(stage_, features_, *sweeps_, last_, run, sweep);
}

}  // namespace zloam::aloam
