#include "common/messages/keys.hpp"

#include <array>
#include <stdexcept>
#include <utility>

namespace zloam {
namespace {

using C = Congestion;
using N = Numbering;

// A sweep of 128 rings, 2048 columns and two returns has 15 MiB. A whole map is only queried, never
// an input of a stage.
constexpr std::size_t kSweep_bytes = std::size_t{32} << 20;
constexpr std::size_t kTile_bytes = std::size_t{16} << 20;
constexpr std::size_t kMap_bytes = std::size_t{1} << 30;
// 64 KiB of text, and the table around it.
constexpr std::size_t kText_bytes = std::size_t{72} << 10;

constexpr std::array kTable = {
    // Lower priority than poses: over a slow link, poses would wait behind every sweep's 100 kB.
    KeyRow{Key::kPackets, "lidar/<sensor>/packets", "packets", "driver, simulator", C::kLiveDrop,
           "interactive_low", N::kSweep, "newest 8", kSweep_bytes},
    KeyRow{Key::kSweep, "lidar/<sensor>/sweep", "sweep", "driver", C::kLiveDrop, "data_high",
           N::kSweep, "live newest 4, replay lossless", kSweep_bytes},
    KeyRow{Key::kImu, "imu/<sensor>", "imu", "any", C::kLiveDrop, "interactive_high", N::kSeq,
           "lossless"},
    KeyRow{Key::kAngle, "lidar/<sensor>/angle", "angle", "any", C::kLiveDrop, "interactive_high",
           N::kSeq, "lossless"},
    KeyRow{Key::kGnss, "gnss/<sensor>", "gnss", "driver", C::kLiveDrop, "interactive_high", N::kSeq,
           "lossless"},
    KeyRow{Key::kFeatures, "lidar/<sensor>/features", "features", "registration", C::kLiveDrop,
           "data_high", N::kSweep, "live newest 4, replay lossless", kSweep_bytes},
    KeyRow{Key::kRejected, "lidar/<sensor>/rejected", "rejected", "registration", C::kLiveDrop,
           "data_low", N::kSweep, "newest 1", kSweep_bytes},
    KeyRow{Key::kOdometry, "odometry", "odometry", "odometry", C::kLiveDrop, "interactive_high",
           N::kSweep, "lossless"},
    KeyRow{Key::kOdometryFeatures, "odometry/features", "odometry_features", "odometry",
           C::kLiveDrop, "data_high", N::kSweep, "live newest 4, replay lossless", kSweep_bytes},
    KeyRow{Key::kOdometrySweep, "odometry/sweep", "cloud", "odometry", C::kLiveDrop, "data_low",
           N::kSweep, "newest 1", kSweep_bytes},
    KeyRow{Key::kProgress, "odometry/progress", "progress", "odometry", C::kDrop,
           "interactive_high", N::kNone, "newest 1"},
    KeyRow{Key::kFlowAck, "flow/<sink>/ack", "flow_ack", "integration, mapping", C::kDrop,
           "interactive_high", N::kNone, "newest 1"},
    KeyRow{Key::kMapCorrection, "map/correction", "map_correction", "mapping", C::kLiveDrop,
           "interactive_high", N::kSweep, "lossless"},
    KeyRow{Key::kMapOdometry, "map/odometry", "map_pose", "mapping", C::kLiveDrop,
           "interactive_high", N::kSweep, "lossless"},
    KeyRow{Key::kMapTile, "map/tile/<layer>/<i>/<j>/<k>", "map_tile", "mapping", C::kLiveDrop,
           "data", N::kNone, "newest 1 of each cube", kTile_bytes},
    KeyRow{Key::kMapSurround, "map/surround", "cloud", "mapping", C::kLiveDrop, "data_low",
           N::kSweep, "newest 1", kMap_bytes},
    KeyRow{Key::kMapCloud, "map/cloud", "cloud", "mapping", C::kLiveDrop, "data_low", N::kSweep,
           "newest 1", kMap_bytes},
    KeyRow{Key::kSweepRegistered, "sweep/registered", "cloud", "mapping", C::kLiveDrop, "data_low",
           N::kSweep, "newest 1", kSweep_bytes},
    KeyRow{Key::kSubmap, "map/submap", "submap", "mapping", C::kLiveDrop, "data", N::kSweep,
           "lossless", kTile_bytes},
    KeyRow{Key::kKeptSubmap, "map/submap/<instant_ns>", "submap", "store", C::kQuery, "data_low",
           N::kNone, "query", kTile_bytes},
    KeyRow{Key::kGraphPoses, "graph/poses", "graph_poses", "graph", C::kLiveDrop, "data", N::kSweep,
           "newest 1", kTile_bytes},
    KeyRow{Key::kGraphLoop, "graph/loop", "loop", "graph", C::kLiveDrop, "data", N::kSeq,
           "lossless"},
    KeyRow{Key::kPathOdometry, "path/odometry", "path", "odometry", C::kQuery, "data_low", N::kNone,
           "query", kMap_bytes},
    KeyRow{Key::kPathMap, "path/map", "path", "mapping", C::kQuery, "data_low", N::kNone, "query",
           kMap_bytes},
    KeyRow{Key::kPathWorld, "path/world", "path", "graph", C::kQuery, "data_low", N::kNone, "query",
           kMap_bytes},
    KeyRow{Key::kPose, "pose", "map_pose", "integration", C::kLiveDrop, "interactive_high",
           N::kSweep, "lossless"},
    KeyRow{Key::kPreview, "preview", "preview", "preview", C::kDrop, "data_low", N::kNone,
           "newest 1", kText_bytes},
    KeyRow{Key::kStatus, "service/<stage>/<instance>/status", "status", "every stage", C::kDrop,
           "background", N::kNone, "newest 1"},
    KeyRow{Key::kConfig, "service/<stage>/<instance>/config", "config", "every stage", C::kQuery,
           "data_low", N::kNone, "query"},
    KeyRow{Key::kTime, "service/<stage>/<instance>/time", "host_time", "every stage", C::kQuery,
           "data_low", N::kNone, "query"},
    KeyRow{Key::kAlive, "service/<stage>/<instance>/alive", "", "every stage", C::kQuery, "data",
           N::kNone, "liveliness token"},
    KeyRow{Key::kActive, "service/<stage>/<instance>/active/<term>/<since_ns>", "",
           "every stage without replicas", C::kQuery, "data", N::kNone, "liveliness token"},
    KeyRow{Key::kRun, "service/driver/<instance>/run/<run>", "", "driver", C::kQuery, "data",
           N::kNone, "liveliness token"},
    KeyRow{Key::kCommand, "command/<stage>/<verb>", "command", "every stage", C::kQuery, "data_low",
           N::kNone, "query", kText_bytes},
    // Below command/, so that an access rule covers it.
    KeyRow{Key::kTakeover, "command/<stage>/takeover/<instance>", "",
           "every stage without replicas", C::kQuery, "data", N::kNone, "query"},
    KeyRow{Key::kConfigRevision, "config/<stage>", "config_revision",
           "registration, odometry, mapping", C::kDrop, "data_high", N::kNone, "all", kText_bytes},
};

std::string chunk(std::string_view text) {
  const std::string error = Keys::chunk_error(text);
  if (!error.empty()) throw std::invalid_argument(error);
  return std::string(text);
}

/// '*' selects all.
std::string chunk_or_all(std::string_view text) {
  return text == "*" ? std::string(text) : chunk(text);
}

}  // namespace

std::span<const KeyRow> key_table() { return kTable; }

const KeyRow& key_row(Key key) {
  const KeyRow& row = kTable.at(static_cast<std::size_t>(key));
  if (row.key != key) throw std::logic_error("the key table is not in the order of enum Key");
  return row;
}

bool fits(Key key, std::size_t bytes) { return bytes <= key_row(key).max_bytes; }

std::string encoding_of_schema(std::string_view schema, int major) {
  return "application/x-flatbuffers;schema=" + std::string(schema) +
         ";major=" + std::to_string(major);
}

std::string encoding_of(Key key) { return encoding_of_schema(key_row(key).schema); }

std::string Keys::chunk_error(std::string_view text) {
  const std::string quoted = "'" + std::string(text) + "'";
  if (text.empty()) return "an empty name can't be part of a key";
  if (text.front() == '@') return quoted + " can't be part of a key: it starts with '@'";
  for (const char c : text) {
    const auto code = static_cast<unsigned char>(c);
    if (std::string_view("/*?#$").find(c) != std::string_view::npos || code <= ' ' ||
        code == 0x7F) {
      return quoted + " can't be part of a key: no '/', '*', '?', '#', '$' or white space";
    }
  }
  return {};
}

Keys::Keys(std::string robot, std::string sensor)
    : robot_(std::move(robot)), sensor_(std::move(sensor)) {
  chunk(robot_);
  chunk(sensor_);
}

std::string Keys::below(std::string_view rest) const {
  return "loam/" + robot_ + "/" + std::string(rest);
}

std::string Keys::of(Key key) const {
  std::string rest(key_row(key).pattern);
  constexpr std::string_view kSensor = "<sensor>";
  if (const auto at = rest.find(kSensor); at != std::string::npos) {
    rest.replace(at, kSensor.size(), sensor_);
  }
  if (rest.find('<') != std::string::npos) {
    throw std::invalid_argument("key " + rest + " needs more than robot and sensor");
  }
  return below(rest);
}

std::string Keys::flow_ack(std::string_view sink) const {
  return below("flow/" + chunk_or_all(sink) + "/ack");
}

std::string Keys::config_revision(std::string_view stage) const {
  return below("config/" + chunk_or_all(stage));
}

std::string Keys::tile(std::string_view layer, int i, int j, int k) const {
  return below("map/tile/" + chunk(layer) + "/" + std::to_string(i) + "/" + std::to_string(j) +
               "/" + std::to_string(k));
}

std::string Keys::all_tiles() const { return below("map/tile/**"); }

std::string Keys::kept_submap(std::int64_t instant_ns) const {
  return below("map/submap/" + std::to_string(instant_ns));
}

std::string Keys::all_kept_submaps() const { return below("map/submap/*"); }

bool Keys::is_kept_submap(std::string_view key) {
  return key.starts_with("loam/") && key.find("/map/submap/") != std::string_view::npos;
}

std::string_view Keys::robot_of(std::string_view key) {
  constexpr std::string_view kRoot = "loam/";
  if (!key.starts_with(kRoot)) return {};
  key.remove_prefix(kRoot.size());
  return key.substr(0, key.find('/'));
}

namespace {
std::string service(std::string_view stage, std::string_view instance, std::string_view leaf) {
  return "service/" + chunk_or_all(stage) + "/" + chunk_or_all(instance) + "/" + std::string(leaf);
}
}  // namespace

std::string Keys::status(std::string_view stage, std::string_view instance) const {
  return below(service(stage, instance, "status"));
}
std::string Keys::config(std::string_view stage, std::string_view instance) const {
  return below(service(stage, instance, "config"));
}
std::string Keys::time(std::string_view stage, std::string_view instance) const {
  return below(service(stage, instance, "time"));
}
std::string Keys::alive(std::string_view stage, std::string_view instance) const {
  return below(service(stage, instance, "alive"));
}
std::string Keys::active(std::string_view stage, std::string_view instance, std::string_view term,
                         std::string_view since_ns) const {
  return below(
      service(stage, instance, "active/" + chunk_or_all(term) + "/" + chunk_or_all(since_ns)));
}
std::string Keys::takeover(std::string_view stage, std::string_view instance) const {
  return command(stage, "takeover") + "/" + chunk(instance);
}
std::string Keys::run(std::string_view instance, std::string_view run) const {
  return below(service("driver", instance, "run/" + chunk_or_all(run)));
}
std::string Keys::command(std::string_view stage, std::string_view verb) const {
  return below("command/" + chunk(stage) + "/" + chunk(verb));
}

}  // namespace zloam
