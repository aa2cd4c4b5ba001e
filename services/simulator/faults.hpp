#pragma once
// Injects faults of networks and clocks into a sensor's packets.

#include <cstdint>
#include <string>
#include <vector>

#include "simulator/capture.hpp"
#include "simulator/random.hpp"

namespace zloam::simulator {

/// From at_s on, the sensor's stamps are shifted by by_s in addition to earlier steps.
struct ClockStep {
  double at_s = 0.0;
  double by_s = 0.0;
};

struct FaultConfig {
  // probabilities for each data packet, 0 to 1
  double loss = 0.0;         ///< the packet never arrives
  double duplication = 0.0;  ///< it arrives twice in a row
  double delay = 0.0;        ///< it arrives after delay_packets later packets
  int delay_packets = 3;
  double corruption = 0.0;    ///< eight random bytes of it are replaced
  double bad_flag = 0.0;      ///< one block's flag is wrong
  double azimuth_jump = 0.0;  ///< the azimuths from some block to the packet's end are off
  double wrong_length = 0.0;  ///< the payload is cut short
  double gap_start_s = 0.0;   ///< from here on no packet arrives for gap_s
  double gap_s = 0.0;
  std::vector<ClockStep> clock_steps;
  std::uint64_t seed = 1;
};

/// An injected fault and the data packet that it affected. A packet can be in the log repeatedly.
struct Fault {
  std::int64_t index;
  std::string kind;    ///< one of fault_kinds()
  std::string detail;  ///< see the README; no commas
};

/// lost, duplicated, late, corrupted, bad_flag, azimuth_jump, cut, gap, clock_step.
std::vector<std::string> fault_kinds();

/// Passes datagrams through in order and injects the configured faults. Which packets are affected
/// depends only on the seed and the packets' numbers.
class FaultInjector {
 public:
  /// start_ns: Unix time of the simulation's start.
  FaultInjector(const FaultConfig& config, std::int64_t start_ns);

  std::vector<Datagram> pass(std::vector<Datagram> in);
  /// The datagrams that are still held back; call it at the end.
  std::vector<Datagram> flush();
  const std::vector<Fault>& log() const { return log_; }

 private:
  struct Held {
    Datagram datagram;
    int overtaken;     // number of later packets that were sent before it
    std::size_t note;  // index of its entry in the log
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
