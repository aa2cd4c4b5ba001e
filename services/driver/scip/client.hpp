#pragma once
// The dialogue with a SCIP device: stops its measurement, identifies it, ties its clock, starts it
// and monitors it. No socket, no clock: takes bytes and times, returns bytes to send.

#include <cstdint>
#include <deque>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "driver/scip/line_clock.hpp"
#include "driver/scip/scan.hpp"

namespace zloam::driver::scip {

struct ClientConfig {
  /// false: only received data is read, as from a recorded session
  bool asks = true;
  bool intensities = true;
  bool several_echoes = false;
  /// steps to measure, from the scanner's front, degrees counter-clockwise; limited to its range.
  /// Of received data, the others are left out
  double from_deg = -180.0;
  double to_deg = 180.0;
  int cluster = 1;
  /// scans skipped between two
  int skipped = 0;
  /// added to the stamps of scans that are tied to their receive times; not if TM1 ties them
  std::int64_t stamp_offset_ns = 0;
};

/// The window of a scanner's steps, as messages name it.
inline constexpr const char* kInWindow =
    "lies between scanner.from_deg and scanner.to_deg of the file in driver.metadata";

/// A scan with its place in time.
struct TimedScan {
  Scan scan;
  /// step 0, ns since the Unix epoch
  std::int64_t stamp_ns = 0;
  /// revolutions since the scan before; 1 when none is missing or skipped
  std::int64_t turns = 1;
  bool clock_step = false;
};

class Client {
 public:
  explicit Client(const ClientConfig& config) : config_(config) {}

  /// A new connection: the dialogue restarts, and its first lines tie the clock again.
  void connected(std::int64_t now_ns);
  void add(std::span<const std::uint8_t> bytes, std::int64_t received_ns);
  /// Checks for timeouts.
  void look(std::int64_t now_ns);

  /// Bytes to send.
  std::string take_output() { return std::exchange(output_, {}); }
  std::optional<TimedScan> take_scan();
  /// No more data will come: returns the scans that wait for more.
  void flush();
  /// True once after a silence that only a new connection can end, or after a reboot.
  bool take_reconnect() { return std::exchange(reconnect_, false); }
  /// Set once the device has identified itself.
  const std::optional<Parameters>& parameters() const { return parameters_; }
  bool measuring() const { return state_ == State::kMeasuring; }

  std::vector<std::pair<std::string_view, std::uint64_t>> counts() const;
  /// Sentences about problems; grows, without duplicates.
  const std::vector<std::string>& remarks() const { return remarks_; }
  /// Why the device can't be used, a sentence. Empty: it can.
  const std::string& refusal() const { return refusal_; }

 private:
  enum class State : std::uint8_t {
    kIdle,
    kStopping,
    kScip2,
    kLeavingAdjust,
    kVersion,
    kParameters,
    kStatus,
    kAdjusting,
    kReadingTime,
    kAdjusted,
    kStarting,
    kMeasuring,
    kRebooting
  };

  void ask(const std::string& command, State state, std::int64_t now_ns);
  void begin(std::int64_t now_ns);
  void untie();
  void on_reply(const RawReply& reply);
  void on_recorded(const RawReply& reply, const Head& head);
  void on_scip1(const RawReply& reply);
  void on_answer(const RawReply& reply, const Head& head);
  void on_scan(const RawReply& reply, const Head& head);
  void on_parameters(const RawReply& reply);
  void on_status(const RawReply& reply);
  void on_counter(const RawReply& reply);
  void on_started(const Head& head, std::int64_t now_ns);
  void tie_clock();
  void place(Scan scan);
  void cut_to_window(Scan& scan);
  std::int64_t turns_to(std::int64_t stamp_ns);
  std::int64_t turns_of_line(const ScanRequest& request, std::int64_t turns);
  LineArrival arrival(const Scan& scan) const;
  void after_adjusting(std::int64_t now_ns);
  void bad_message(std::int64_t now_ns);
  void fault(const Head& head, std::int64_t now_ns);
  void wait_until_stable(const Head& head);
  void reboot(std::int64_t now_ns);
  void say(const std::string& remark);
  ScanRequest request() const;

  ClientConfig config_;
  State state_ = State::kIdle;
  std::string asked_;
  std::int64_t asked_ns_ = 0;
  std::int64_t heard_ns_ = 0;
  /// a reply to the last command has come, whatever it says
  bool is_answered_ = false;
  /// dialogues that did not get to the end since the scanner measured last, checked itself, or was
  /// connected
  int unfinished_ = 0;
  int bad_in_row_ = 0;
  std::string output_;
  bool reconnect_ = false;
  ReplyReader reader_;
  std::optional<Parameters> parameters_;
  /// until there are enough scans to tie the clock
  std::vector<Scan> first_;
  std::optional<LineClock> clock_;
  /// added to the clock's times
  std::int64_t offset_ns_ = 0;
  /// steps of the clocks before
  std::uint64_t steps_before_ = 0;
  bool first_of_clock_ = false;
  /// of the scan placed last
  std::int64_t last_stamp_ns_ = 0;
  /// a scan of a continuous measurement has come
  bool has_line_ = false;
  /// revolutions since the last of them, and the part that single scans have had
  std::int64_t turns_since_line_ = 0;
  std::int64_t turns_of_singles_ = 0;
  /// of the TM1 with the least round trip
  struct Tie {
    std::uint32_t counter_ms = 0;
    std::int64_t host_ns = 0;
    std::int64_t round_ns = 0;
  };
  std::optional<Tie> tie_;
  int counters_read_ = 0;
  std::deque<TimedScan> scans_;
  std::vector<std::string> remarks_;
  std::string refusal_;

  std::uint64_t replies_ = 0;
  std::uint64_t scans_read_ = 0;
  std::uint64_t scans_lost_ = 0;
  std::uint64_t bad_status_ = 0;
  std::uint64_t bad_checksum_ = 0;
  std::uint64_t bad_characters_ = 0;
  std::uint64_t bad_length_ = 0;
  std::uint64_t unexpected_ = 0;
  std::uint64_t timeouts_ = 0;
  std::uint64_t faults_ = 0;
  std::uint64_t restarts_ = 0;
};

}  // namespace zloam::driver::scip
