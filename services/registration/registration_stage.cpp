#include "registration/registration_stage.hpp"

#include <csignal>
#include <numeric>
#include <string_view>
#include <vector>

#include "common/runtime/fault.hpp"
#include "common/runtime/recall.hpp"
#include "common/runtime/replicas.hpp"
#include "common/runtime/shared.hpp"

namespace zloam::registration {
namespace {

using runtime::Message;
using runtime::Outcome;

std::optional<std::uint64_t> kill_at() {
  const std::optional<std::uint64_t> sweep = runtime::fault("ZLOAM_FAULT_KILL_AT");
  if (sweep) {
    runtime::log_warning("FAULT INJECTION: this process will kill itself", {{"sweep", *sweep}});
  }
  return sweep;
}

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
  // A sweep with lost packets is still matched, but its health is passed on.
  const Health source = health_of(sweep.health());
  f.health = result.health == Health::kOk ? source : result.health;
  f.range_noise_m = static_cast<float>(config.range_noise_m);
  f.imu = structs_of(sweep.imu());
  f.slices = sweep.slices();
  return f;
}

}  // namespace

RegistrationStage::RegistrationStage(runtime::Stage& stage, const RegistrationConfig& config,
                                     const SharingConfig& sharing)
    : stage_(stage),
      config_(config),
      features_(stage.outlet(Key::kFeatures)),
      rejected_(stage.outlet(Key::kRejected)),
      sharing_(stage.identity().instance, sharing),
      kill_at_(kill_at()),
      colleagues_(stage, [&stage] { stage.notify(); }) {
  runtime::InletOptions options;
  options.on_given_up = [this](std::uint64_t run, std::uint64_t sweep, std::string_view) {
    publish_dropped(run, sweep);
  };
  sweeps_ = &stage.inlet<msg::Sweep>(Key::kSweep, options,
                                     [this](const Sweep& sweep) { return take(sweep); });
  stage.on_poll([this] { return settle_held(); });
  stage.answer_set_if([this](std::uint64_t run) {
    hear_colleagues();
    return sharing_.first(run, 0);
  });
  stage.on_late_revision([this](std::uint64_t run, std::uint64_t from) { do_again(run, from); });
}

void RegistrationStage::hear_colleagues() {
  sharing_.set_members(colleagues_.members());
  if (auto progress = colleagues_.progress()) sharing_.set_progress(std::move(*progress));
}

Outcome RegistrationStage::take(const Sweep& sweep) {
  hear_colleagues();
  watch_runs(sweep);
  const SweepToShare key{sweep.run(), sweep.sweep(), sweep.replay(), sweep.raw().bytes.size()};
  switch (sharing_.take(key, runtime::steady_ns())) {
    case Sharing::Share::kNotMine:
      return Outcome::kNotMine;
    case Sharing::Share::kHold:
      held_.emplace(std::pair(sweep.run(), sweep.sweep()), sweep.raw());
      return Outcome::kHeld;
    case Sharing::Share::kCompute:
      break;
  }
  process(sweep);
  return Outcome::kProcessed;
}

void RegistrationStage::watch_runs(const Sweep& sweep) {
  if (sweep.replay()) return;
  const PacketSpan span{sweep->first_packet_toh_us(), sweep->last_packet_toh_us(),
                        sweep->packet_period_ns(), sweep.header().last_packet_ns()};
  const bool other_run = sweep.run() != newest_run_;
  if (other_run && newest_run_ != 0) {
    const std::int64_t missing = packets_between(newest_, span);
    packets_between_ += missing;
    stage_.figure("packets_between_runs", static_cast<double>(packets_between_));
    runtime::log_warning("the driver was started again", {{"packets_missed", missing}});
  }
  // A recovered sweep arrives after later ones and must not replace the newest.
  if (!other_run && span.last_received_ns < newest_.last_received_ns) return;
  newest_run_ = sweep.run();
  newest_ = span;
}

runtime::Poll RegistrationStage::settle_held() {
  if (held_.empty()) return runtime::Poll::kWait;
  hear_colleagues();
  for (const Sharing::Due& due : sharing_.due(runtime::steady_ns())) {
    auto node = held_.extract(std::pair(due.run, due.sweep));
    sweeps_->settle(std::move(node.mapped()), [this, &due](const Message& message) {
      if (!due.compute) return Outcome::kNotMine;
      process(Sweep(message));
      stage_.figure("redone", static_cast<double>(++redone_));
      return Outcome::kProcessed;
    });
  }
  return runtime::Poll::kWait;
}

// Odometry drops features made with another revision and waits for new ones. The driver still keeps
// the sweeps.
void RegistrationStage::do_again(std::uint64_t run, std::uint64_t from_sweep) {
  if (run != last_.run || from_sweep > last_.sweep) return;
  const std::string sweeps = runtime::sweeps_from(run, from_sweep, last_.sweep);
  for (const Sweep& sweep : runtime::recall<msg::Sweep>(stage_, Key::kSweep, sweeps, 1)) {
    process(sweep);
    stage_.figure("done_again", static_cast<double>(++done_again_));
  }
}

void RegistrationStage::process(const Sweep& sweep) {
  if (kill_at_ && sweep.sweep() >= *kill_at_) std::raise(SIGKILL);
  stage_.configure_for(sweep);
  const SweepInfo info{.period_ns = sweep->period_ns(),
                       .rings = sweep->rings(),
                       .one_return = has_one_return(*sweep)};
  const RegistrationResult result = extract_features(points_of(sweep->points()), info, config_);
  const HeaderFields header = features_.header(sweep);
  features_.publish(header, build(header, fields_of(*sweep, result, config_)));
  if (rejected_.matching()) publish_rejected(sweep, result);
  // A held sweep may be done after later ones.
  if (header.run != last_.run || header.sweep >= last_.sweep) last_ = header;
  stage_.figure("points_in", result.diagnostics.points_in);
  stage_.figure("measured_noise_m", result.diagnostics.measured_noise_m);
}

void RegistrationStage::publish_rejected(const Sweep& sweep, const RegistrationResult& result) {
  const HeaderFields header = rejected_.header(sweep);
  const auto* reasons = reinterpret_cast<const msg::RejectReason*>(result.reasons.data());
  rejected_.publish(
      header, build(header, RejectedFields{result.rejected, {reasons, result.reasons.size()}}));
}

/// Only the replica that ranks first for the sweep reports it, as another one may have the sweep.
void RegistrationStage::publish_dropped(std::uint64_t run, std::uint64_t sweep) {
  hear_colleagues();
  if (!sharing_.first(run, sweep)) return;
  runtime::publish_dropped(stage_, features_, *sweeps_, last_, run, sweep);
}

}  // namespace zloam::registration
