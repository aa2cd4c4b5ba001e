#pragma once
// Faults on demand: what networks and clocks do to a sensor's packets.

#include <cstdint>
#include <string>
#include <vector>

#include "simulator/capture.hpp"

namespace zloam::simulator {

struct FaultConfig {
  double loss = 0.0;         ///< part of the data packets that never arrive
  double duplication = 0.0;  ///< part that arrives twice
  double delay = 0.0;        ///< part that arrives after delay_packets later ones
  int delay_packets = 3;
  double corruption = 0.0;    ///< part with eight bytes of noise somewhere
  double wrong_length = 0.0;  ///< part that is cut short
  double gap_start_s = 0.0;   ///< nothing at all arrives for gap_s from here
  double gap_s = 0.0;
  double clock_step_at_s = 0.0;  ///< from here the sensor's stamps are off by clock_step_s
  double clock_step_s = 0.0;
  std::uint64_t seed = 1;
};

/// What was done to which data packet.
struct Fault {
  std::int64_t index;
  std::string kind;  ///< lost, duplicated, late, corrupted, cut, gap, clock_step
};

/// Passes datagrams through, in order, and does to them what the configuration says. Which packet
/// is hit depends on the seed and the packet's number only.
class FaultInjector {
 public:
  /// start_ns: Unix time of the simulation's start.
  FaultInjector(const FaultConfig& config, std::int64_t start_ns);

  std::vector<Datagram> pass(std::vector<Datagram> in);
  /// What is still held back, at the end.
  std::vector<Datagram> flush();
  const std::vector<Fault>& log() const { return log_; }

 private:
  struct Held {
    Datagram datagram;
    int remaining;
  };
  void pass_one(Datagram datagram, std::vector<Datagram>& out);
  bool disturb_time(Datagram& datagram);
  void release(std::int64_t now_ns, std::vector<Datagram>& out);

  FaultConfig config_;
  std::int64_t start_ns_;
  bool stepped_ = false;
  std::vector<Held> held_;
  std::vector<Fault> log_;
};

}  // namespace zloam::simulator
