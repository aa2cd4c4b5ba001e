// zloam-registration: takes decoded sweeps, gives the feature clouds of each.

#include <cstdint>
#include <numeric>
#include <string>
#include <string_view>

#include "common/runtime/stage.hpp"
#include "registration/registration.hpp"
#include "registration/registration_parameters.hpp"

namespace {

using namespace zloam;
using namespace zloam::registration;
using runtime::Received;
using runtime::Stage;

FeaturesFields fields_of(const msg::Sweep& sweep, const RegistrationResult& result,
                         const RegistrationConfig& config) {
  FeaturesFields f;
  f.period_ns = sweep.period_ns();
  f.rings = sweep.rings();
  f.sharp = result.sharp;
  f.less_sharp = result.less_sharp;
  f.flat = result.flat;
  f.less_flat = result.less_flat;
  f.points_in = result.diagnostics.points_in;
  f.points_rejected = std::accumulate(std::begin(result.diagnostics.rejected),
                                      std::end(result.diagnostics.rejected), std::uint32_t{0});
  f.deskewed = sweep.deskewed();
  // A sweep that lost packets is still matched, and says so.
  const Health source = health_of(sweep.health());
  f.health = result.health == Health::kOk ? source : result.health;
  f.range_noise_m = static_cast<float>(config.range_noise_m);
  return f;
}

class Registration {
 public:
  Registration(Stage& stage, const RegistrationConfig& config)
      : stage_(stage),
        config_(config),
        features_(stage.outlet(Key::kFeatures)),
        rejected_(stage.outlet(Key::kRejected)) {
    runtime::InletOptions options;
    options.on_given_up = [this](std::uint64_t run, std::uint64_t sweep, std::string_view) {
      publish_dropped(run, sweep);
    };
    stage.inlet<msg::Sweep>(Key::kSweep, options,
                            [this](const Received<msg::Sweep>& sweep) { process(sweep); });
  }

 private:
  void process(const Received<msg::Sweep>& sweep) {
    const SweepInfo info{.period_ns = sweep->period_ns(), .rings = sweep->rings()};
    const RegistrationResult result = extract_features(points_of(sweep->points()), info, config_);
    const HeaderFields header = features_.header(sweep);
    features_.publish(header, build(header, fields_of(*sweep, result, config_)));
    if (rejected_.matching()) publish_rejected(sweep, result);
    last_ = header;
    stage_.figure("points_in", result.diagnostics.points_in);
    stage_.figure("measured_noise_m", result.diagnostics.measured_noise_m);
  }

  void publish_rejected(const Received<msg::Sweep>& sweep, const RegistrationResult& result) {
    const HeaderFields header = rejected_.header(sweep);
    const auto* reasons = reinterpret_cast<const msg::RejectReason*>(result.reasons.data());
    rejected_.publish(
        header, build(header, RejectedFields{result.rejected, {reasons, result.reasons.size()}}));
  }

  /// Odometry need not wait for a sweep that was given up here: an empty message says so.
  void publish_dropped(std::uint64_t run, std::uint64_t sweep) {
    HeaderFields header = features_.header(stage_.now_ns(), stage_.now_ns());
    header.run = run;
    header.sweep = sweep;
    header.frame = "lidar";
    header.stamp_ns = last_.stamp_ns;
    features_.publish(header, build(header, FeaturesFields{.health = Health::kDropped}));
  }

  Stage& stage_;
  const RegistrationConfig& config_;
  runtime::Outlet& features_;
  runtime::Outlet& rejected_;
  HeaderFields last_;
};

}  // namespace

int main(int argc, char** argv) {
  RegistrationConfig config;
  std::unique_ptr<Registration> registration;
  return runtime::run_stage(
      argc, argv,
      {.name = "registration",
       .summary = "Picks edge and plane features out of each sweep (LOAM).",
       .bind = [&](runtime::Parameters& p) { bind(p, config); },
       .wire =
           [&](Stage& stage) { registration = std::make_unique<Registration>(stage, config); }});
}
