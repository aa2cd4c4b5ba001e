#pragma once
// Faults on demand: what networks and clocks do to a sensor's packets.

#include <cstdint>
#include <string>
#include <vector>

#include "simulator/capture.hpp"
#include "simulator/random.hpp"

namespace zloam::simulator {

/// From at_s on the sensor's stamps are off by by_s more than before.
struct ClockStep {
  double at_s = 0.0;
  double by_s = 0.0;
};

struct FaultConfig {
  double loss = 0.0;         ///< part of the data packets that never arrive
  double duplication = 0.0;  ///< part that arrives twice, one right after the other
  double delay = 0.0;        ///< part that arrives after delay_packets later ones
  int delay_packets = 3;
  double corruption = 0.0;    ///< part with eight bytes of noise somewhere
  double bad_flag = 0.0;      ///< part in which one block's flag is wrong
  double azimuth_jump = 0.0;  ///< part whose azimuths are off from some block to the packet's end
  double wrong_length = 0.0;  ///< part that is cut short
  double gap_start_s = 0.0;   ///< nothing at all arrives for gap_s from here
  double gap_s = 0.0;
  std::vector<ClockStep> clock_steps;
  std::uint64_t seed = 1;
};

/// What was done to which data packet. A packet can be in the log more than once.
struct Fault {
  std::int64_t index;
  std::string kind;    ///< one of fault_kinds()
  std::string detail;  ///< see the README; no commas
};

/// lost, duplicated, late, corrupted, bad_flag, azimuth_jump, cut, gap, clock_step.
std::vector<std::string> fault_kinds();

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
    int overtaken;     // by so many later packets
    std::size_t note;  // its place in the log
  };
  void pass_one(Datagram datagram, std::vector<Datagram>& out);
  bool disturb_time(Datagram& datagram);
  void disturb_bytes(Datagram& datagram, Random& random);
  void overtake(std::int64_t now_ns, std::vector<Datagram>& out);

  FaultConfig config_;
  std::int64_t start_ns_;
  std::size_t steps_done_ = 0;
  double step_s_ = 0.0;
  std::vector<Held> held_;
  std::vector<Fault> log_;
};

}  // namespace zloam::simulator
