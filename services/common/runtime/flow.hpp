#pragma once
// Pacing of a replay (docs/protocol.md, section 4): the sinks report their progress; the driver
// keeps at most a window of sweeps in flight and publishes again what seems lost.

#include <cstdint>
#include <string>

namespace zloam::runtime {

/// The sink's side (integration, mapping).
class FlowAck {
 public:
  virtual ~FlowAck() = default;
  /// Reports every sweep below the number as finished here, whatever its result. Publishes; a
  /// number that is not greater than the last of the run is ignored.
  virtual void done_below(std::uint64_t run, std::uint64_t sweep) = 0;
  /// A sweep of the run was taken, and waits for another stage: repeats the last report, so that a
  /// standby sees that this instance works.
  virtual void waits(std::uint64_t run) = 0;
};

/// The driver's side.
class FlowWindow {
 public:
  virtual ~FlowWindow() = default;

  /// Live: names the run by the start time; nothing is waited for.
  virtual void start_live() = 0;
  /// Replay: waits (poll begun()) for a ready instance of each stage in flow.wait_for, then names
  /// the run by the capture's hash and the configurations of all stages. capture_hash: any text
  /// that is a function of the capture's bytes, e.g. SHA-256 in hex.
  virtual void start_replay(const std::string& capture_hash) = 0;

  /// Whether the run is named and its first sweep may be sent. Logs every 2 s what it waits for.
  virtual bool begun() const = 0;
  virtual std::uint64_t run() const = 0;
  virtual bool replay() const = 0;
  /// First sweep that is not finished everywhere: 0 for a new run, greater if the driver was
  /// restarted within a run; lower sweeps need not be published.
  virtual std::uint64_t resume_at() const = 0;
  /// Whether this sweep may be published now. Live: always. A change wakes the worker.
  virtual bool may_send(std::uint64_t sweep) const = 0;
  /// All sinks have finished every sweep up to the last one published with end_of_run. A driver
  /// that finds resume_at() beyond its last sweep has nothing to publish and is finished without
  /// it.
  virtual bool finished() const = 0;
  /// Smallest done_below of the sinks.
  virtual std::uint64_t done_below() const = 0;
};

}  // namespace zloam::runtime
