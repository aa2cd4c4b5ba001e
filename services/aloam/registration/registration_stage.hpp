#pragma once
// A-LOAM's scan registration on the runtime. Of several instances each does every sweep; odometry
// takes the first copy.

#include "aloam/config.hpp"
#include "aloam/core/sensor_defaults.hpp"
#include "common/runtime/stage.hpp"

namespace zloam::aloam {

class RegistrationStage {
 public:
  explicit RegistrationStage(runtime::Stage& stage);

 private:
  using Sweep = runtime::Received<msg::Sweep>;

  void process(const Sweep& sweep);
  /// Odometry need not wait for a sweep that was dropped here: an empty message says so.
  void publish_dropped(std::uint64_t run, std::uint64_t sweep);

  runtime::Stage& stage_;
  SensorDefaults defaults_;
  runtime::Outlet& features_;
  runtime::Inlet* sweeps_ = nullptr;
  HeaderFields last_;
};

}  // namespace zloam::aloam
