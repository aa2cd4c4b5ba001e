#pragma once
// All keys of the system in one place, each with its schema and how it is delivered. Nothing else
// in the tree spells a key; schemas/README.md shows the same table and a test compares the two.

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>

namespace zloam {

enum class Key : std::uint8_t {
  kPackets,
  kSweep,
  kImu,
  kAngle,
  kGnss,
  kFeatures,
  kRejected,
  kOdometry,
  kOdometryFeatures,
  kOdometrySweep,
  kProgress,
  kFlowAck,
  kMapCorrection,
  kMapOdometry,
  kMapTile,
  kMapSurround,
  kMapCloud,
  kSweepRegistered,
  kSubmap,
  kKeptSubmap,
  kGraphPoses,
  kGraphLoop,
  kPathOdometry,
  kPathMap,
  kPathWorld,
  kPose,
  kPreview,
  kStatus,
  kConfig,
  kTime,
  kAlive,
  kActive,
  kRun,
  kCommand,
  kTakeover,
  kConfigRevision,
};

/// What a publisher does when a reader is slow. kLiveDrop: drop from a live sensor, block in
/// replay.
enum class Congestion : std::uint8_t { kLiveDrop, kDrop, kQuery };

/// How messages of a key are numbered, and so recovered: by sweep, by the publisher's seq, not at
/// all.
enum class Numbering : std::uint8_t { kSweep, kSeq, kNone };

/// One row of the table.
struct KeyRow {
  Key key;
  /// the key below loam/<robot>/; <name> is replaced by a value
  std::string_view pattern;
  /// file name of the schema without .fbs; empty for liveliness tokens
  std::string_view schema;
  std::string_view publisher;
  Congestion congestion;
  /// Zenoh's name: interactive_high, interactive_low, data_high, data, data_low, background
  std::string_view priority;
  Numbering numbering;
  /// messages that a receiver's queue keeps
  std::string_view queue;
  /// Maximum size; larger messages are dropped before a byte of them is copied or read.
  std::size_t max_bytes = std::size_t{1} << 20;
};

std::span<const KeyRow> key_table();
const KeyRow& key_row(Key key);
/// Whether a message of this size can belong to the key.
bool fits(Key key, std::size_t bytes);

/// "application/x-flatbuffers;schema=<name>;major=<n>"
std::string encoding_of(Key key);
std::string encoding_of_schema(std::string_view schema, int major = 1);

/// Keys of one robot and its sensor. Names must be non-empty and free of '/', '*', '?', '#', '$',
/// '@' at their start and white space; anything else throws std::invalid_argument.
class Keys {
 public:
  Keys(std::string robot, std::string sensor);

  /// Full key of a row that needs nothing but robot and sensor; throws std::invalid_argument for
  /// others.
  std::string of(Key key) const;
  std::string flow_ack(std::string_view sink) const;
  std::string tile(std::string_view layer, int i, int j, int k) const;
  std::string all_tiles() const;
  std::string kept_submap(std::int64_t instant_ns) const;
  std::string all_kept_submaps() const;
  /// Whether the key is that of a kept submap of any robot.
  static bool is_kept_submap(std::string_view key);
  /// The robot whose key this is; empty: of none.
  static std::string_view robot_of(std::string_view key);
  std::string status(std::string_view stage, std::string_view instance) const;
  std::string config(std::string_view stage, std::string_view instance) const;
  std::string time(std::string_view stage, std::string_view instance) const;
  std::string alive(std::string_view stage, std::string_view instance) const;
  /// "*" for any instance, term and time
  std::string active(std::string_view stage, std::string_view instance, std::string_view term,
                     std::string_view since_ns) const;
  std::string takeover(std::string_view stage, std::string_view instance) const;
  std::string run(std::string_view instance, std::string_view run) const;
  std::string command(std::string_view stage, std::string_view verb) const;
  /// "*" for all stages
  std::string config_revision(std::string_view stage) const;

  const std::string& robot() const { return robot_; }
  const std::string& sensor() const { return sensor_; }

  /// Why the text can't be one chunk of a key; empty when it can.
  static std::string chunk_error(std::string_view text);

 private:
  std::string below(std::string_view rest) const;
  std::string robot_;
  std::string sensor_;
};

}  // namespace zloam
