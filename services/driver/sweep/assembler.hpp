#pragma once
// Cuts the stream of packets into sweeps at a fixed azimuth, by firing group, so that a packet may
// feed two sweeps. Fixed numbers of packets per revolution are wrong: the true number is fractional
// and the motor's speed drifts.

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string_view>
#include <utility>
#include <vector>

#include "driver/decoder/packet_decoder.hpp"
#include "driver/sweep/clock.hpp"
#include "driver/sweep/decoded_sweep.hpp"
#include "driver/sweep/mask.hpp"

namespace zloam::driver {

struct AssemblerConfig {
  /// where sweeps are cut, degrees clockwise from the sensor's front
  double seam_azimuth_deg = 0.0;
  /// a sweep also ends after this time without a cut (slow or stopped motor)
  std::int64_t guard_ns = 300'000'000;
  /// packets buffered at a gap, to reorder late arrivals
  int reorder_packets = 4;
  ClockMode clock_mode = ClockMode::kReceive;
  /// receive time of the first packet, if known better than from its own receive time
  std::int64_t first_received_ns = 0;
  /// written to the sweeps
  ClockSource clock_source = ClockSource::kUnknown;
  /// added to every stamp; e.g. for a sensor that stamps the last firing of a packet
  std::int64_t stamp_offset_ns = 0;
  MaskConfig mask = {};
};

/// Counts of all input, and of packets without points by reason.
struct PacketCounts {
  std::uint64_t received = 0;
  std::uint64_t decoded = 0;
  std::uint64_t points = 0;
  std::uint64_t too_short = 0;
  std::uint64_t foreign = 0;
  std::uint64_t unknown_model = 0;
  std::uint64_t model_mismatch = 0;
  std::uint64_t unknown_mode = 0;
  std::uint64_t bad_time = 0;
  std::uint64_t duplicate = 0;
  /// arrived after its place in the order had passed
  std::uint64_t late = 0;
  /// never arrived, by the stamps; not the late ones
  std::uint64_t lost = 0;
  /// arrived after a later one and was put back in order
  std::uint64_t reordered = 0;
  /// blocks of decoded packets with an unknown flag or azimuth
  std::uint64_t bad_blocks = 0;
  /// the sensor's clock was set; the sweep was restarted
  std::uint64_t clock_steps = 0;
  /// the host's clock was set; the sweeps' times continue
  std::uint64_t host_clock_steps = 0;
  /// returns dropped by the mask
  std::uint64_t points_masked = 0;

  std::vector<std::pair<std::string_view, std::uint64_t>> named() const;
};

class SweepAssembler {
 public:
  SweepAssembler(std::unique_ptr<PacketDecoder> decoder, const AssemblerConfig& config);

  /// One datagram's payload and its receive time (ns since the Unix epoch, 0: unknown).
  void add(std::span<const std::uint8_t> payload, std::int64_t received_ns);

  /// Ends the open sweep, which is marked incomplete: at the end of the source, or after a silence.
  void flush();

  /// Swaps the next finished sweep into out, whose buffers are reused; false when there is
  /// none.
  bool take(DecodedSweep& out);

  const PacketCounts& counts() const { return counts_; }
  const PacketDecoder& decoder() const { return *decoder_; }
  /// Epoch time of an instant of the sensor's time of the hour; nothing before the first packet is
  /// decoded.
  std::optional<std::int64_t> epoch_ns(std::int64_t toh_ns) const;
  /// With ClockMode::kUtc, by how much the stamps are ahead of the sensor's UTC: the run keeps the
  /// time that it began with when the sensor's clock is set.
  std::int64_t ahead_of_utc_ns() const;

 private:
  struct Held {
    std::vector<std::uint8_t> payload;
    PacketTail tail;
    std::int64_t received_ns;
  };
  struct Packet {
    std::span<const std::uint8_t> payload;
    PacketTail tail;
    std::int64_t received_ns;
  };

  static Held held_copy(const Packet& packet);
  bool accepted(const PacketTail& tail);
  void begin(const Packet& packet);
  void order(const Packet& packet);
  std::int64_t received_after_us(const Packet& packet) const;
  std::int64_t stamped_after_us(const Packet& packet) const;
  bool clock_stepped(const Packet& packet, std::int64_t ahead_us) const;
  void suspect_step(const Packet& packet);
  void confirm_step();
  void drop_suspect();
  void count_overtaken(std::uint32_t toh_us, std::int64_t ahead_us);
  bool contiguous(const Packet& packet) const;
  bool hold(const Packet& packet);
  void release_held(std::size_t keep);
  void release_contiguous();
  void process_first_held();
  std::int64_t elapsed_ns(const Packet& packet) const;
  void restart(const Packet& packet, std::int64_t ahead_ns);
  void process(const Packet& packet, std::int64_t ahead_ns);
  std::int64_t missing_before(const Packet& packet, std::int64_t ahead_ns) const;
  std::int64_t due_ns(const PacketTail& tail) const;
  double rotation_cdeg(std::int64_t time_ns) const;
  bool within_a_turn(const PacketTail& tail, std::int64_t ahead_ns) const;
  bool across_view_gap(const PacketTail& tail, std::int64_t ahead_ns) const;
  bool lost_again(const PacketTail& tail, std::int64_t ahead_ns);
  void forget_seen_gap(const PacketTail& tail);
  void decode_groups(const PacketPlan& plan, std::int64_t packet_ns, std::int64_t received_ns);
  void count_packet(const PacketPlan& plan);
  void advance_to(const PacketPlan& plan, int group, std::int64_t time_ns);
  void cut(const PacketPlan& plan, std::int64_t time_ns, int phase_cdeg, bool at_seam);
  void make_room(const PacketPlan& plan, std::size_t points);
  void place_group(int group, std::int64_t time_ns);
  void append_placed(const PacketPlan& plan);
  void open(std::int64_t time_ns, int phase_cdeg, bool at_seam);
  void close(bool at_seam);
  std::uint32_t measured_period_ns() const;

  AssemblerConfig config_;
  PointMask mask_;
  int seam_cdeg_;
  std::unique_ptr<PacketDecoder> decoder_;
  SensorClock clock_;
  PacketCounts counts_;

  // The stream so far; times are the sensor's own, unwrapped.
  bool started_ = false;
  std::uint32_t last_toh_us_ = 0;
  std::int64_t sensor_ns_ = 0;
  std::int64_t last_received_ns_ = 0;
  std::int64_t expected_ahead_ns_ = 0;
  /// the part of it in which the sensor rotates through a gap of the field of view
  std::int64_t expected_gap_ns_ = 0;
  int last_azimuth_cdeg_ = 0;
  double last_advance_cdeg_ = 0.0;
  int view_gap_from_cdeg_ = -1;
  int view_gap_to_cdeg_ = -1;
  /// a large gap between two packets: in how many successive revolutions it was there, its edges in
  /// the first of them, and the time of the packet before the last
  int lost_in_a_row_ = 0;
  int lost_from_cdeg_ = 0;
  int lost_to_cdeg_ = 0;
  std::int64_t lost_at_ns_ = 0;
  /// packets missing just before the packet's first group
  std::int64_t lost_before_ = 0;
  std::vector<Held> held_;
  /// at most one: after the clock was set, or an outlier; the next packet decides
  std::vector<Held> suspect_;
  int late_in_a_row_ = 0;
  /// stamps of the packets decoded last, to detect a late duplicate
  std::array<std::uint32_t, 128> recent_toh_us_{};
  std::size_t recent_ = 0;
  /// where packets are missing, to recognize one that arrives late
  struct Gap {
    std::int64_t from_ns = 0;
    std::int64_t to_ns = 0;
    std::int64_t missing = 0;
  };
  std::array<Gap, 32> gaps_{};
  std::size_t next_gap_ = 0;

  // The open sweep. Phase: azimuth behind the seam.
  bool open_ = false;
  bool began_at_seam_ = false;
  bool packet_counted_ = false;
  DecodedSweep sweep_;
  // number of its points; its buffers are longer while it is open
  std::size_t filled_ = 0;
  std::int64_t base_ns_ = 0;
  std::int64_t first_group_ns_ = 0;
  std::int64_t last_group_ns_ = 0;
  int phase_cdeg_ = 0;
  std::int64_t turned_cdeg_ = 0;
  std::uint32_t last_period_ns_ = 0;
  // the packet's groups that are in the sweep and not decoded yet
  std::array<PlacedGroup, kMostGroups> placed_{};
  std::size_t placed_count_ = 0;

  std::vector<DecodedSweep> ready_;
  std::vector<DecodedSweep> spare_;
};

}  // namespace zloam::driver
