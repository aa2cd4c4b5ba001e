#pragma once
// Sweeps of a recording that another program reads: bags of ROS 1 and 2, MCAP files. Their formats
// are read by their own libraries in Python (`zloam recording`), which writes sweeps into a pipe as
// it goes on: nothing of a recording is stored twice.
//
// The pipe holds frames, little endian: "ZLRC", uint32 kind, uint64 bytes that follow.
//
//   1  identity   text: "clouds", "packets" or "messages", and the recording's identity, from
//                 which a replay's number is made
//   2  sweep      RecordedSweep, then points of 24 bytes (common/geometry/point.hpp)
//   3  remark     text: a problem with the recording
//   4  refusal    text: why it cannot be used; nothing follows
//   5  end        nothing follows; without it the reader has died
//   6  packets    for each RecordedPacket, then its bytes
//   7  reading    RecordedReading of an inertial sensor, before the sweep after it; one of a
//                 message after this message, and before the next one
//   8  message    a sweep as a driver published it (schemas/sweep.fbs), of a robot's own recording

#include <cstdint>
#include <memory>
#include <string>

#include "driver/io/scan_folder.hpp"

namespace zloam::driver {

enum class FrameKind : std::uint32_t {
  kIdentity = 1,
  kSweep = 2,
  kRemark = 3,
  kRefusal = 4,
  kEnd = 5,
  kPackets = 6,
  kReading = 7,
  kMessage = 8
};

struct FrameHead {
  char magic[4];
  std::uint32_t kind;
  std::uint64_t bytes;
};
static_assert(sizeof(FrameHead) == 16);

struct RecordedSweep {
  /// of the first point, ns since the Unix epoch
  std::int64_t stamp_ns;
  std::uint32_t period_ns;
  /// 0: the points have none
  std::uint16_t rings;
  std::uint8_t deskewed;
  std::uint8_t complete;
};
static_assert(sizeof(RecordedSweep) == 16);

struct RecordedPacket {
  std::int64_t received_ns;
  std::uint16_t bytes;
  std::uint16_t reserved[3];
};
static_assert(sizeof(RecordedPacket) == 16);

struct RecordedReading {
  std::int64_t stamp_ns;
  double force_mps2[3];
  double rate_radps[3];
};
static_assert(sizeof(RecordedReading) == 56);

struct RecordingOptions {
  std::string path;
  /// the program that reads it
  std::string reader;
  /// empty: the only topic of its kind
  std::string topic;
  /// whether inertial readings are wanted, and of which topic; empty: the only one
  bool imu = false;
  std::string imu_topic;
  /// field of the points' times; empty: found by its name
  std::string time_field;
  ScanTiming timing;
};

/// A recording has either clouds or packets. Packets are decoded as those of a capture.
struct Recording {
  std::string identity;
  std::unique_ptr<ScanFolder> clouds;
  std::unique_ptr<PacketSource> packets;
};

/// Throws SourceError, with the reader's own text if it refused.
Recording open_recording(const RecordingOptions& options);

}  // namespace zloam::driver
