#pragma once
// The driver on the runtime: publishes sweeps, raw packets and GNSS sentences, paced or live.

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "common/runtime/stage.hpp"
#include "driver/driver_parameters.hpp"
#include "driver/io/closed_ports.hpp"
#include "driver/io/imu_feed.hpp"
#include "driver/io/scip_source.hpp"
#include "driver/io/sweep_source.hpp"

namespace zloam::driver {

class DriverStage {
 public:
  /// Opens the source; throws ConfigError or IoError.
  DriverStage(runtime::Stage& stage, const DriverConfig& config);

 private:
  struct Outgoing {
    DecodedSweep sweep;
    std::vector<RawPacket> packets;
  };

  void open_finite();
  void open_udp_source();
  void open_zenoh();
  void open_scanner();
  void hear_angles(ScipSource& turned);

  runtime::Poll poll_live();
  /// The next sweep of a live source, if there is one.
  bool pull_live(Outgoing& outgoing);
  /// Live: sweeps are published when their inertial readings are there, or after a bounded wait.
  void publish_waiting();
  runtime::Poll poll_replay();
  runtime::Poll finish_replay();
  /// Reads one sweep ahead, so that the last one is known when it is published.
  bool fetch();
  bool due();
  void on_packets(const runtime::Received<msg::Packets>& packets);

  void publish(const Outgoing& outgoing, bool last);
  void publish_packets(const Outgoing& outgoing);
  void publish_positions();
  void watch_clock(const PositionPacket& packet);
  void report_steps(const DecodedSweep& sweep);
  void report_step(const std::string& whose, std::int64_t step_ns);
  void watch_quiet(bool sweep_came);
  void watch_sweeps(bool sweep_came);
  void every_second();
  void say_remarks();
  void say_troubles();
  std::string place() const;
  std::string advice_on_silence() const;
  void say_counts();
  NamedCounts counts() const;
  std::uint64_t to_closed_ports() const;

  runtime::Stage& stage_;
  DriverConfig config_;
  runtime::Outlet& sweeps_;
  runtime::Outlet& packets_;
  runtime::Outlet& gnss_;
  runtime::FlowWindow& window_;

  std::optional<ImuFeed> imu_;
  std::unique_ptr<SweepSource> source_;
  /// source zenoh: packets come by the inlet instead
  std::unique_ptr<PacketStream> stream_;
  std::optional<Outgoing> current_;
  std::optional<Outgoing> next_;
  /// live: waits for its inertial readings
  std::optional<Outgoing> waiting_;
  std::int64_t waiting_since_ns_ = 0;
  bool source_ended_ = false;
  bool last_published_ = false;
  std::uint64_t number_ = 0;
  std::optional<double> rate_;
  std::int64_t first_stamp_ns_ = 0;
  std::int64_t pace_start_ns_ = 0;

  std::string last_sentence_;
  std::uint64_t seen_datagrams_ = 0;
  std::int64_t last_datagram_ns_ = 0;
  /// of this host, before this stage started
  std::uint64_t to_closed_ports_before_ = datagrams_to_closed_ports();
  bool quiet_ = false;
  /// data that come since then have given no sweep
  std::int64_t no_sweep_since_ns_ = 0;
  bool no_sweep_ = false;
  bool flushed_ = true;
  std::vector<std::string> remarks_said_, troubles_;
  int seconds_ = 0;
  /// until when the last clock step is reported
  int step_said_until_ = 0;
};

}  // namespace zloam::driver
