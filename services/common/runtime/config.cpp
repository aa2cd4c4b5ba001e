#include "common/runtime/config.hpp"

#include "common/messages/keys.hpp"
#include "common/runtime/parameters.hpp"
#include "common/runtime/session_config.hpp"

namespace zloam::runtime {
namespace {

void bind_zenoh(Parameters& p, ZenohConfig& c) {
  p.add("zenoh.host", &c.host,
        "address of the stages' own endpoints; <stage> in it stands for each stage's name, if each "
        "runs on its own host or in its own container",
        Effect::kNone);
  p.add("zenoh.base_port", &c.base_port, {0, 65000}, "",
        "port of the driver; the next stages listen on the following ports; 0: no endpoints",
        Effect::kNone);
  p.add("zenoh.listen", &c.listen, "listen endpoints that replace the stage's own", Effect::kNone);
  p.add("zenoh.connect", &c.connect, "further endpoints to connect to, e.g. the router's",
        Effect::kNone);
  p.add("zenoh.shared_memory", &c.shared_memory,
        "send large messages through shared memory if possible", Effect::kNone);
  p.add("zenoh.pool_mib", &c.pool_mib, {1, 4096}, "MiB", "shared memory pool of this process",
        Effect::kNone);
  p.add("zenoh.lease_ms", &c.lease_ms, {100, 60000}, "ms",
        "time without a keep-alive after which a peer is dropped", Effect::kNone);
  p.check("zenoh.host", [&c] { return host_error(c.host); });
  p.check("zenoh.listen", [&c] { return endpoints_error(c.listen); });
  p.check("zenoh.connect", [&c] { return endpoints_error(c.connect); });
}

void bind_flow(Parameters& p, SharedConfig& c) {
  p.add("flow.window", &c.flow.window, {1, 1000}, "sweeps",
        "replay: maximum number of sweeps in progress", Effect::kNone);
  p.add("flow.sinks", &c.flow.sinks, "replay: stages whose acknowledgements pace it",
        Effect::kNone);
  p.add("flow.wait_for", &c.flow.wait_for, "replay: stages that must be ready before it starts",
        Effect::kNone);
  p.add("flow.retransmit_ms", &c.flow.retransmit_ms, {50, 60000}, "ms",
        "replay: delay before a sweep without progress is published again", Effect::kNone);
  p.check("flow.window",
          [&c]() -> std::string {
            if (c.flow.window <= c.recovery.keep_messages) return {};
            return "must not exceed recovery.keep_messages (" +
                   std::to_string(c.recovery.keep_messages) +
                   "), or a lost sweep can't be requested again";
          },
          {"recovery.keep_messages"});
}

void bind_recovery(Parameters& p, RecoveryConfig& c) {
  p.add("recovery.keep_messages", &c.keep_messages, {1, 100000}, "",
        "messages kept by a publisher for recovery; at least flow.window", Effect::kNone);
  p.add("recovery.keep_mib", &c.keep_mib, {1, 65536}, "MiB",
        "bytes kept by a publisher for recovery", Effect::kNone);
  p.add("recovery.gap_live_ms", &c.gap_live_ms, {1, 10000}, "ms",
        "live: delay before a missing sweep is requested", Effect::kNone);
  p.add("recovery.gap_replay_ms", &c.gap_replay_ms, {1, 60000}, "ms",
        "replay: delay before a missing sweep is requested", Effect::kNone);
  p.add("recovery.late_ms", &c.late_ms, {0, 60000}, "ms",
        "live: delay after which a missing sweep is dropped; 0: one measured sweep period",
        Effect::kNone);
  p.add("recovery.replay_limit_s", &c.replay_limit_s, {1, 86400}, "s",
        "replay: a sweep missing for this long ends the run with an error", Effect::kNone);
  p.add("recovery.queue_sweeps", &c.queue_sweeps, {1, 1000}, "",
        "live: sweeps queued before the oldest is dropped", Effect::kNone);
  p.add("recovery.queue_mib", &c.queue_mib, {1, 65536}, "MiB",
        "limit of the bytes queued by one input", Effect::kNone);
  p.add(
      "recovery.standby", &c.standby,
      "allow a second instance of a stage, which stands by and takes over when the first has gone",
      Effect::kNone);
}

}  // namespace

std::vector<std::string> owned_sections() {
  std::vector<std::string> sections = {"aloam"};
  for (const StageRow& row : stage_list()) sections.push_back(row.name);
  return sections;
}

void bind(Parameters& p, SharedConfig& c) {
  p.add("robot", &c.robot, "name of the robot in all keys", Effect::kNone);
  p.add("sensor.name", &c.sensor.name, "name of the lidar in its keys", Effect::kNone);
  p.add("sensor.model", &c.sensor.model, "model of the lidar, as on its label");
  p.add("mounting.xyz_m", &c.mounting.xyz_m, {-1000.0, 1000.0}, "m",
        "origin of the lidar in base_link");
  p.add("mounting.rpy_deg", &c.mounting.rpy_deg, {-360.0, 360.0}, "deg",
        "roll, pitch, yaw of the lidar in base_link: R = Rz Ry Rx");
  p.add("mounting.imu_xyz_m", &c.mounting.imu_xyz_m, {-1000.0, 1000.0}, "m",
        "origin of the IMU in base_link");
  p.add("mounting.imu_rpy_deg", &c.mounting.imu_rpy_deg, {-360.0, 360.0}, "deg",
        "roll, pitch, yaw of the IMU in base_link");
  bind_zenoh(p, c.zenoh);
  p.add("log.level", &c.log.level, {"debug", "info", "warning", "error"},
        "minimum severity that is logged", Effect::kNone);
  p.add("log.format", &c.log.format, {"text", "json"}, "format of a log line", Effect::kNone);
  bind_flow(p, c);
  bind_recovery(p, c.recovery);
  p.check("robot", [&c] { return Keys::chunk_error(c.robot); });
  p.check("sensor.name", [&c] { return Keys::chunk_error(c.sensor.name); });
}

}  // namespace zloam::runtime
