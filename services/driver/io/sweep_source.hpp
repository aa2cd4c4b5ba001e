#pragma once
// Sweeps from any source, with the data that came with them.

#include <cstdint>
#include <deque>
#include <memory>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "driver/decoder/makers.hpp"
#include "driver/io/packet_source.hpp"
#include "driver/io/scan_folder.hpp"
#include "driver/io/stream_filter.hpp"
#include "driver/sweep/assembler.hpp"

namespace zloam::driver {

struct RawPacket {
  std::vector<std::uint8_t> payload;
  std::int64_t received_ns = 0;
  std::uint16_t port = 0;
};

/// The packets that arrived since the last sweep, while somebody records them. Without sweeps, for
/// example of packets that can't be decoded, only the first ones are kept.
class PacketsForRecorder {
 public:
  /// More than any sensor sends in a sweep.
  static constexpr std::size_t kMost = 8192;

  void record(bool on) {
    on_ = on;
    if (!on) packets_.clear();
  }
  void add(std::span<const std::uint8_t> payload, std::int64_t received_ns, std::uint16_t port) {
    if (!on_) return;
    if (packets_.size() == kMost) {
      ++left_out_;
    } else {
      packets_.push_back({{payload.begin(), payload.end()}, received_ns, port});
    }
  }
  std::vector<RawPacket> take() { return std::exchange(packets_, {}); }
  std::uint64_t left_out() const { return left_out_; }

 private:
  bool on_ = false;
  std::vector<RawPacket> packets_;
  std::uint64_t left_out_ = 0;
};

struct ReceivedPosition {
  PositionPacket packet;
  std::int64_t received_ns = 0;
};

enum class Pull : std::uint8_t { kSweep, kNothing, kEnd };

class SweepSource {
 public:
  virtual ~SweepSource() = default;
  /// kNothing: a live source has none yet. Throws SourceError.
  virtual Pull pull(DecodedSweep& sweep) = 0;
  /// Ends the open sweep of a live source that has gone quiet.
  virtual void flush() {}
  virtual NamedCounts counts() const = 0;
  /// Sentences about problems that remain for the whole run; grows.
  virtual std::vector<std::string> remarks() const { return {}; }
  /// Sentences about problems that there are now.
  virtual std::vector<std::string> troubles() const { return {}; }

  /// Another sender of the sensor's kind of packets, which are skipped; 0: there is none.
  virtual std::uint32_t other_sender() const { return 0; }

  /// Packets that arrived since the last sweep, while recording.
  virtual void record(bool /*on*/) {}
  virtual std::vector<RawPacket> take_packets() { return {}; }
  /// Position packets since the last call.
  virtual std::vector<ReceivedPosition> take_positions() { return {}; }
  /// Readings of the sensor's own IMU since the last call, in the sweeps' time.
  virtual std::vector<ImuReading> take_imu() { return {}; }
};

/// Points dropped from every source's sweeps.
struct PointLimits {
  double min_range_m = 0.0;
  double max_range_m = 1000.0;
  MaskConfig mask = {};
};

struct PacketStreamConfig {
  DecodingOptions decoding;
  AssemblerConfig assembler;
  std::uint16_t port = 0;
  std::uint32_t sender = 0;
};

/// Converts datagrams from any source to sweeps.
class PacketStream {
 public:
  explicit PacketStream(const PacketStreamConfig& config);

  void add(const Datagram& datagram);
  void flush();
  bool take(DecodedSweep& sweep) { return assembler_ && assembler_->take(sweep); }

  void record(bool on) { recorded_.record(on); }
  std::vector<RawPacket> take_packets() { return recorded_.take(); }
  std::vector<ReceivedPosition> take_positions() { return std::exchange(positions_, {}); }
  std::vector<ImuReading> take_imu() { return std::exchange(imu_, {}); }
  NamedCounts counts() const;
  std::vector<std::string> remarks() const;
  std::vector<std::string> troubles() const;
  std::uint64_t data_packets() const { return data_packets_; }
  /// Another sender of data packets, which are skipped; 0: there is none.
  std::uint32_t other_sender() const { return filter_.other_sender(); }

 private:
  struct Kept {
    std::vector<std::uint8_t> payload;
    std::int64_t received_ns;
  };
  struct First {
    Kept kept;
    /// a data packet of the sensor, not a malformed one
    bool data;
  };

  void add_data(std::span<const std::uint8_t> payload, std::int64_t received_ns);
  void add_malformed(std::span<const std::uint8_t> payload, std::int64_t received_ns);
  void begin_if_known();
  void keep_newcomer(const Datagram& datagram);
  void adopt(const Datagram& datagram, DatagramKind kind);
  void begin();
  void keep_position(const Datagram& datagram);
  void keep_imu(const Datagram& datagram);

  PacketStreamConfig config_;
  Makers makers_;
  StreamFilter filter_;
  /// the first packets, until there are enough to know the model
  std::vector<First> first_;
  std::size_t first_data_ = 0;
  /// packets of a sender that may be the sensor with another address, and that sender
  std::vector<Kept> newcomer_;
  std::uint32_t newcomer_sender_ = 0;
  std::unique_ptr<SweepAssembler> assembler_;
  /// it began with malformed packets only, and so for a model that is not known yet
  bool only_counts_ = false;
  /// of such assemblers, which are replaced at the first data packet
  PacketCounts before_data_;
  std::vector<std::string> remarks_;
  PacketsForRecorder recorded_;
  std::vector<ReceivedPosition> positions_;
  std::vector<ImuReading> imu_;
  std::uint64_t data_packets_ = 0;
  std::uint64_t bad_positions_ = 0;
};

/// timeout_ms: longest wait of a live source for a packet in one call.
std::unique_ptr<SweepSource> sweeps_of_packets(std::unique_ptr<PacketSource> packets,
                                               const PacketStreamConfig& config, int timeout_ms);
std::unique_ptr<SweepSource> sweeps_of_scans(std::unique_ptr<ScanFolder> scans,
                                             const PointLimits& limits = {});

/// "packets_received 12, points 4": only the counts above 0.
std::string counted(const NamedCounts& counts);
std::uint64_t count_of(const NamedCounts& counts, std::string_view name);

/// SHA-256 in hexadecimal over the concatenated bytes of the files.
std::string hash_of_files(const std::vector<std::string>& paths);

}  // namespace zloam::driver
