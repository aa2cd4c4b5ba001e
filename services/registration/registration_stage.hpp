#pragma once
// Registration on the runtime: keys and headers around the method (registration.hpp), and the work
// of one replica among several (sharing.hpp).

#include <cstdint>
#include <map>
#include <optional>
#include <utility>

#include "common/runtime/stage.hpp"
#include "registration/io/colleagues.hpp"
#include "registration/packet_gap.hpp"
#include "registration/registration.hpp"
#include "registration/sharing.hpp"

namespace zloam::registration {

class RegistrationStage {
 public:
  RegistrationStage(runtime::Stage& stage, const RegistrationConfig& config,
                    const SharingConfig& sharing);

 private:
  using Sweep = runtime::Received<msg::Sweep>;

  runtime::Outcome take(const Sweep& sweep);
  /// Handles held sweeps that must be computed here after all or were computed elsewhere.
  runtime::Poll settle_held();
  void hear_colleagues();
  void process(const Sweep& sweep);
  /// Repeats the sweeps processed before this replica received the revision in force at them.
  void do_again(std::uint64_t run, std::uint64_t from_sweep);
  void publish_rejected(const Sweep& sweep, const RegistrationResult& result);
  void publish_dropped(std::uint64_t run, std::uint64_t sweep);
  /// Counts packets that the sensor sent between two runs of a live driver.
  void watch_runs(const Sweep& sweep);

  runtime::Stage& stage_;
  const RegistrationConfig& config_;
  runtime::Outlet& features_;
  runtime::Outlet& rejected_;
  runtime::Inlet* sweeps_ = nullptr;
  HeaderFields last_;
  /// newest run of the sensor, whichever replica computes it
  std::uint64_t newest_run_ = 0;
  PacketSpan newest_;
  std::int64_t packets_between_ = 0;
  Sharing sharing_;
  /// (run, sweep) -> the message, in memory of this process
  std::map<std::pair<std::uint64_t, std::uint64_t>, runtime::Message> held_;
  std::uint64_t redone_ = 0;
  /// since a revision arrived late
  std::uint64_t done_again_ = 0;
  /// ZLOAM_FAULT_KILL_AT: this process kills itself between a sweep's receipt and its output
  std::optional<std::uint64_t> kill_at_;
  // Last: its callbacks must end before the members they use are destroyed.
  Colleagues colleagues_;
};

}  // namespace zloam::registration
