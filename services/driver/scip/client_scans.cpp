// The client's scans: their clock, their place in time, and the revolutions between them.

#include <algorithm>
#include <utility>

#include "driver/scip/client.hpp"

namespace zloam::driver::scip {
namespace {

// Lines of this much time tie the clock.
constexpr std::int64_t kTieNs = 1'000'000'000;

}  // namespace

void Client::on_scan(const RawReply& reply, const Head& head) {
  Scan scan;
  switch (read_scan(reply, head, scan)) {
    case ScanError::kNone:
      break;
    case ScanError::kNoScan:
      return;
    case ScanError::kChecksum:
      ++bad_checksum_;
      return bad_message(reply.received_ns);
    case ScanError::kCharacters:
      ++bad_characters_;
      return bad_message(reply.received_ns);
    case ScanError::kLength:
      ++bad_length_;
      return bad_message(reply.received_ns);
  }
  bad_in_row_ = 0;
  ++scans_read_;
  if (!parameters_) {
    say("scans came before the scanner's parameters (PP): without them they are of no use");
    return;
  }
  if (clock_) return place(std::move(scan));
  first_.push_back(std::move(scan));
  const std::int64_t apart = 1 + first_.front().request.skipped;
  const std::int64_t span_ns =
      static_cast<std::int64_t>(first_.size()) * parameters_->turn_ns() * apart;
  if (span_ns >= kTieNs) tie_clock();
}

LineArrival Client::arrival(const Scan& scan) const {
  return {scan.counter_ms, parameters_->step_ns(scan.request.last_step), scan.received_ns};
}

void Client::tie_clock() {
  std::vector<LineArrival> arrivals;
  for (const Scan& scan : first_) arrivals.push_back(arrival(scan));
  clock_.emplace(parameters_->turn_ns(), arrivals);
  first_of_clock_ = true;
  if (tie_) clock_->tie(tie_->counter_ms, tie_->host_ns);
  // TM1 tells the time of the counter itself; receive times are later by the transmission.
  offset_ns_ = tie_ ? 0 : config_.stamp_offset_ns;
  for (Scan& scan : std::exchange(first_, {})) place(std::move(scan));
}

void Client::place(Scan scan) {
  const std::uint64_t steps = clock_->steps();
  TimedScan timed;
  timed.stamp_ns = clock_->place(arrival(scan)) + offset_ns_;
  timed.clock_step = clock_->steps() != steps;
  if (timed.clock_step) say("the scanner's counter was set: was it started again?");
  if (clock_->take_host_step_ns() != 0 && !config_.asks) {
    say("the clock of the host that received the scans was set during the session: from then on, "
        "angles stamped by it do not fit the lines");
  }
  timed.turns = std::max<std::int64_t>(0, turns_to(timed.stamp_ns));
  turns_since_line_ += timed.turns;
  if (scan.request.continuous) {
    timed.turns = turns_of_line(scan.request, timed.turns);
  } else {
    turns_of_singles_ += timed.turns;
  }
  last_stamp_ns_ = timed.stamp_ns;
  // A live scanner sends no other steps.
  if (!config_.asks) cut_to_window(scan);
  timed.scan = std::move(scan);
  scans_.push_back(std::move(timed));
}

/// Leaves out the steps that a live scanner would not have been asked for.
void Client::cut_to_window(Scan& scan) {
  const ScanRequest wanted = request();
  ScanRequest& sent = scan.request;
  const int first = std::max(sent.first_step, wanted.first_step);
  const int last = std::min(sent.last_step, wanted.last_step);
  if (first == sent.first_step && last == sent.last_step) return;
  std::erase_if(scan.echoes,
                [&](const Echo& echo) { return echo.step < first || echo.step > last; });
  if (last < first) return say(std::string("no step of the recorded lines ") + kInWindow);
  sent.first_step = first;
  sent.last_step = last;
}

/// Revolutions from the scan before, which may be of an earlier connection.
std::int64_t Client::turns_to(std::int64_t stamp_ns) {
  if (!std::exchange(first_of_clock_, false) || last_stamp_ns_ == 0) return clock_->turns();
  const std::int64_t turn_ns = parameters_->turn_ns();
  return (stamp_ns - last_stamp_ns_ + turn_ns / 2) / turn_ns;
}

/// Lines are whole steps of 1 + skipped revolutions apart, whatever single scans (GD, GE) were
/// asked for in between: of those none is missing, however long the host waited.
std::int64_t Client::turns_of_line(const ScanRequest& request, std::int64_t turns) {
  const std::int64_t since_line = std::exchange(turns_since_line_, 0);
  const std::int64_t of_singles = std::exchange(turns_of_singles_, 0);
  if (!std::exchange(has_line_, true)) return turns;
  const std::int64_t apart = 1 + request.skipped;
  const std::int64_t lines = std::max<std::int64_t>(1, (since_line + apart / 2) / apart);
  scans_lost_ += static_cast<std::uint64_t>(lines - 1);
  return std::max<std::int64_t>(0, lines * apart - of_singles);
}

void Client::flush() {
  if (!first_.empty()) tie_clock();
}

std::optional<TimedScan> Client::take_scan() {
  if (scans_.empty()) return std::nullopt;
  TimedScan scan = std::move(scans_.front());
  scans_.pop_front();
  return scan;
}

}  // namespace zloam::driver::scip
