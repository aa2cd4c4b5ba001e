#include "common/runtime/config.hpp"

#include "common/messages/keys.hpp"
#include "common/runtime/parameters.hpp"

namespace zloam::runtime {
namespace {

void bind_zenoh(Parameters& p, ZenohConfig& c) {
  p.add("zenoh.host", &c.host, "address of the stages' own endpoints", Effect::kNone);
  p.add("zenoh.base_port", &c.base_port, {0, 65000}, "",
        "driver listens here, the stages after it on the ports that follow; 0: no endpoints",
        Effect::kNone);
  p.add("zenoh.listen", &c.listen, "replaces the stage's own listen endpoint", Effect::kNone);
  p.add("zenoh.connect", &c.connect, "further endpoints, e.g. the router's", Effect::kNone);
  p.add("zenoh.shared_memory", &c.shared_memory, "large messages through /dev/shm where possible",
        Effect::kNone);
  p.add("zenoh.pool_mib", &c.pool_mib, {1, 4096}, "MiB", "shared memory of this process",
        Effect::kNone);
  p.add("zenoh.shared_memory_threshold", &c.shared_memory_threshold, {64, 1 << 30}, "bytes",
        "smaller messages go through the socket", Effect::kNone);
  p.add("zenoh.lease_ms", &c.lease_ms, {100, 60000}, "ms",
        "a peer that says nothing for so long is given up", Effect::kNone);
}

void bind_recovery(Parameters& p, RecoveryConfig& c) {
  p.add("recovery.keep_messages", &c.keep_messages, {1, 100000}, "",
        "messages that a publisher keeps to be asked for by number", Effect::kNone);
  p.add("recovery.keep_mib", &c.keep_mib, {1, 65536}, "MiB", "bound of the same", Effect::kNone);
  p.add("recovery.gap_live_ms", &c.gap_live_ms, {1, 10000}, "ms",
        "live: a missing sweep is asked for after", Effect::kNone);
  p.add("recovery.gap_replay_ms", &c.gap_replay_ms, {1, 60000}, "ms",
        "replay: a missing sweep is asked for after", Effect::kNone);
  p.add("recovery.late_ms", &c.late_ms, {0, 60000}, "ms",
        "live: a missing sweep is given up after; 0: one measured sweep period", Effect::kNone);
  p.add("recovery.replay_limit_s", &c.replay_limit_s, {1, 86400}, "s",
        "replay: a sweep missing for so long ends the run with an error", Effect::kNone);
  p.add("recovery.queue_sweeps", &c.queue_sweeps, {1, 1000}, "",
        "live: sweeps held before the oldest is dropped", Effect::kNone);
  p.add("recovery.queue_mib", &c.queue_mib, {1, 65536}, "MiB", "bytes held by one input",
        Effect::kNone);
}

}  // namespace

void bind(Parameters& p, SharedConfig& c) {
  p.add("robot", &c.robot, "name of the robot in all keys", Effect::kNone);
  p.add("sensor.name", &c.sensor.name, "name of the lidar in its keys", Effect::kNone);
  p.add("sensor.model", &c.sensor.model, "as on its label, e.g. VLP-16");
  p.add("mounting.xyz_m", &c.mounting.xyz_m, {-1000.0, 1000.0}, "m",
        "origin of the lidar in base_link");
  p.add("mounting.rpy_deg", &c.mounting.rpy_deg, {-360.0, 360.0}, "deg",
        "roll, pitch, yaw of the lidar in base_link: R = Rz Ry Rx");
  p.add("mounting.imu_xyz_m", &c.mounting.imu_xyz_m, {-1000.0, 1000.0}, "m",
        "origin of the inertial sensor in base_link");
  p.add("mounting.imu_rpy_deg", &c.mounting.imu_rpy_deg, {-360.0, 360.0}, "deg",
        "roll, pitch, yaw of the inertial sensor in base_link");
  bind_zenoh(p, c.zenoh);
  p.add("log.level", &c.log.level, {"debug", "info", "warning", "error"}, "least that is written",
        Effect::kNone);
  p.add("log.format", &c.log.format, {"text", "json"}, "form of a line", Effect::kNone);
  p.add("flow.window", &c.flow.window, {1, 1000}, "sweeps", "sweeps under way in replay",
        Effect::kNone);
  p.add("flow.sinks", &c.flow.sinks, "stages whose acknowledgements pace a replay", Effect::kNone);
  p.add("flow.wait_for", &c.flow.wait_for, "stages that must be ready before a replay starts",
        Effect::kNone);
  p.add("flow.retransmit_ms", &c.flow.retransmit_ms, {50, 60000}, "ms",
        "replay: a sweep without progress is published again after", Effect::kNone);
  bind_recovery(p, c.recovery);
  p.check("robot", [&c] { return Keys::chunk_error(c.robot); });
  p.check("sensor.name", [&c] { return Keys::chunk_error(c.sensor.name); });
}

}  // namespace zloam::runtime
