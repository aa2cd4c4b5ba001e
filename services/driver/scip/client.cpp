#include "driver/scip/client.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <stdexcept>

namespace zloam::driver::scip {
namespace {

constexpr std::int64_t kSecondNs = 1'000'000'000;
// A device answers within some milliseconds; QT during measurement within one revolution.
constexpr std::int64_t kAnswerNs = kSecondNs;
constexpr std::int64_t kSilentNs = kSecondNs;
constexpr std::int64_t kRebootNs = 10 * kSecondNs;
constexpr int kMostUnfinished = 3;
constexpr int kMostBad = 3;
constexpr int kCounterReadings = 10;
// Status of a measurement that goes on after a self-check.
constexpr const char* kHasChecked = "98";
constexpr const char* kChecked = "the scanner stopped to check itself, and measures again";
constexpr const char* kNoIntensities = "the scanner gives no intensities: they are 0";

bool well(const Head& head) { return head.status == "00"; }

}  // namespace

void Client::connected(std::int64_t now_ns) {
  reader_.clear();
  output_.clear();
  untie();
  unfinished_ = 0;
  heard_ns_ = now_ns;
  if (!config_.asks) {
    state_ = State::kMeasuring;
    return;
  }
  begin(now_ns);
}

/// Whoever was away may have been started again: each connection has a clock of its own.
void Client::untie() {
  tie_.reset();
  first_.clear();
  if (clock_) steps_before_ += clock_->steps();
  clock_.reset();
}

void Client::begin(std::int64_t now_ns) {
  bad_in_row_ = 0;
  ask("QT", State::kStopping, now_ns);
}

void Client::ask(const std::string& command, State state, std::int64_t now_ns) {
  output_ += command + "\n";
  asked_ = command;
  asked_ns_ = now_ns;
  is_answered_ = false;
  state_ = state;
}

void Client::add(std::span<const std::uint8_t> bytes, std::int64_t received_ns) {
  reader_.add(bytes, received_ns);
  while (const auto reply = reader_.take()) on_reply(*reply);
}

void Client::look(std::int64_t now_ns) {
  if (!config_.asks || state_ == State::kIdle) return;
  if (state_ == State::kRebooting || state_ == State::kMeasuring) {
    const bool reboots = state_ == State::kRebooting;
    if (now_ns - (reboots ? asked_ns_ : heard_ns_) < (reboots ? kRebootNs : kSilentNs)) return;
    if (!reboots) ++timeouts_;
    state_ = State::kIdle;
    reconnect_ = true;
    return;
  }
  if (now_ns - asked_ns_ < kAnswerNs) return;
  if (!is_answered_) ++timeouts_;
  if (++unfinished_ < kMostUnfinished) return begin(now_ns);
  // What was wrong with an answer has been said when it came.
  if (!is_answered_) {
    say("no answer to " + asked_ +
        " from what is at driver.path: is it a Hokuyo scanner (SCIP 2), and its serial line, if it "
        "has one, at 115200 or 19200 bit/s?");
  }
  state_ = State::kIdle;
  reconnect_ = true;
}

void Client::say(const std::string& remark) {
  if (std::find(remarks_.begin(), remarks_.end(), remark) == remarks_.end()) {
    remarks_.push_back(remark);
  }
}

void Client::bad_message(std::int64_t now_ns) {
  const bool expected = state_ == State::kStopping || state_ == State::kRebooting;
  if (!config_.asks || expected || ++bad_in_row_ < kMostBad) return;
  ++restarts_;
  begin(now_ns);
}

void Client::on_reply(const RawReply& reply) {
  ++replies_;
  heard_ns_ = reply.received_ns;
  const auto head = head_of(reply);
  // Elsewhere, a status of one character is a damaged one.
  const bool mode_is_open = state_ == State::kStopping || state_ == State::kScip2;
  if (!head && mode_is_open && is_of_scip1(reply)) return on_scip1(reply);
  if (!head) {
    ++bad_status_;
    return bad_message(reply.received_ns);
  }
  // Data of an earlier measurement still arrives before ours has been started; it is ignored.
  const bool ours = state_ == State::kMeasuring || state_ == State::kStarting;
  const bool data = scan_request(*head) && reply.lines.size() > 2;
  if (data) return ours ? on_scan(reply, *head) : void();
  is_answered_ = is_answered_ || head->command + head->parameters == asked_;
  if (is_fault(*head)) return fault(*head, reply.received_ns);
  if (!config_.asks) return on_recorded(reply, *head);
  if (is_unstable(*head)) return wait_until_stable(*head);
  if (head->command + head->parameters != asked_) {
    unexpected_ += state_ == State::kStopping ? 0 : 1;
    return;
  }
  on_answer(reply, *head);
}

/// The scanner of a session can be neither asked nor rebooted: its replies are only reported.
void Client::on_recorded(const RawReply& reply, const Head& head) {
  if (head.command == "PP") return on_parameters(reply);
  if (head.command == "II") return on_status(reply);
  if (is_unstable(head)) return wait_until_stable(head);
  if (head.status == kHasChecked) say(kChecked);
  if (!is_refusal(head)) return;
  // Whoever recorded the session then asked for the distances alone.
  const bool without_intensities = is_unknown(head) && head.command == "ME";
  say(without_intensities ? kNoIntensities : "the scanner refused to measure: " + meaning(head));
}

/// Some scanners speak SCIP 1 until they are told to change, and do not know QT in it.
void Client::on_scip1(const RawReply& reply) {
  if (reply.lines.front() != asked_) return;
  is_answered_ = true;
  if (state_ == State::kStopping) return ask("SCIP2.0", State::kScip2, reply.received_ns);
  if (reply.lines.back() == "0") return ask("TM2", State::kLeavingAdjust, reply.received_ns);
  say("the scanner speaks SCIP 1 and refuses to change to SCIP 2: is its firmware too old?");
}

void Client::on_answer(const RawReply& reply, const Head& head) {
  const std::int64_t now_ns = reply.received_ns;
  switch (state_) {
    case State::kStopping:
      return head.status == "0E" ? ask("SCIP2.0", State::kScip2, now_ns)
                                 : ask("TM2", State::kLeavingAdjust, now_ns);
    case State::kScip2:
      return ask("TM2", State::kLeavingAdjust, now_ns);
    case State::kLeavingAdjust:
      return ask("VV", State::kVersion, now_ns);
    case State::kVersion:
      return ask("PP", State::kParameters, now_ns);
    case State::kParameters:
      return on_parameters(reply);
    case State::kStatus:
      return on_status(reply);
    case State::kAdjusting:
      if (well(head) || head.status == "02") {
        counters_read_ = 0;
        return ask("TM1", State::kReadingTime, now_ns);
      }
      return after_adjusting(now_ns);
    case State::kReadingTime:
      return on_counter(reply);
    case State::kAdjusted:
      return after_adjusting(now_ns);
    case State::kStarting:
      return on_started(head, now_ns);
    default:
      if (head.status == kHasChecked) say(kChecked);
  }
}

void Client::on_parameters(const RawReply& reply) {
  int damaged = 0;
  const auto values = values_of(reply, damaged);
  bad_checksum_ += static_cast<std::uint64_t>(damaged);
  try {
    const Parameters now = parameters_of(values);
    if (parameters_ && parameters_->turn_ns() != now.turn_ns()) untie();
    parameters_ = now;
  } catch (const std::invalid_argument& error) {
    say(std::string("the scanner can't be used: ") + error.what());
    if (config_.asks) bad_message(reply.received_ns);
    return;
  }
  if (!config_.asks) return;
  if (request().last_step < request().first_step) {
    refusal_ = std::string("none of the scanner's steps ") + kInWindow;
    return;
  }
  ask("II", State::kStatus, reply.received_ns);
}

void Client::on_status(const RawReply& reply) {
  int damaged = 0;
  const auto values = values_of(reply, damaged);
  const auto status = values.find("STAT");
  if (status != values.end() && status->second.find("abnormal") != std::string::npos) {
    ++faults_;
    say("the scanner says of itself: " + status->second);
    return reboot(reply.received_ns);
  }
  if (config_.asks) ask("TM0", State::kAdjusting, reply.received_ns);
}

void Client::on_counter(const RawReply& reply) {
  if (const auto counter = counter_of(reply)) {
    const std::int64_t round_ns = reply.received_ns - asked_ns_;
    if (round_ns >= 0 && (!tie_ || round_ns < tie_->round_ns)) {
      tie_ = {*counter, asked_ns_ + round_ns / 2, round_ns};
    }
  } else {
    ++bad_checksum_;
  }
  const bool more = ++counters_read_ < kCounterReadings;
  ask(more ? "TM1" : "TM2", more ? State::kReadingTime : State::kAdjusted, reply.received_ns);
}

void Client::after_adjusting(std::int64_t now_ns) {
  if (!tie_)
    say("the scanner does not tell its counter (TM0, TM1): its lines' times are tied to "
        "when they are received");
  ask(continuous_command(request()), State::kStarting, now_ns);
}

void Client::on_started(const Head& head, std::int64_t now_ns) {
  const bool has_checked = head.status == kHasChecked;
  if (has_checked) say(kChecked);
  if (well(head) || has_checked) {
    unfinished_ = 0;
    state_ = State::kMeasuring;
    return;
  }
  const bool unknown = is_unknown(head);
  if (unknown && config_.intensities && !config_.several_echoes) {
    config_.intensities = false;
    say(kNoIntensities);
    return after_adjusting(now_ns);
  }
  refusal_ = "the scanner does not measure: " + meaning(head);
  if (unknown && config_.several_echoes)
    refusal_ += "; set scanner.several_echoes: false in driver.metadata";
}

void Client::fault(const Head& head, std::int64_t now_ns) {
  ++faults_;
  say("the scanner reports a fault: " + meaning(head));
  // 21 to 49: the scanner checks itself, and reports kHasChecked when it has finished.
  const bool checks = head.status >= "21" && head.status <= "49";
  // However long it takes: if it checks itself when it is to start, it is asked again each second.
  if (checks) unfinished_ = 0;
  // A device may repeat its status until it reboots, or for ever.
  if (!checks && state_ != State::kRebooting) reboot(now_ns);
}

/// The state ends by itself. Until then the dialogue starts again each second, without a limit.
void Client::wait_until_stable(const Head& head) {
  say("the scanner is not ready: " + meaning(head));
  unfinished_ = 0;
}

void Client::reboot(std::int64_t now_ns) {
  if (!config_.asks) return;
  // The device reboots only if RB arrives twice within a second.
  output_ += "RB\nRB\n";
  asked_ = "RB";
  asked_ns_ = now_ns;
  state_ = State::kRebooting;
}

ScanRequest Client::request() const {
  const Parameters& p = *parameters_;
  const auto step = [&](double degrees) {
    return p.front_step + static_cast<int>(std::lround(degrees / 360.0 * p.steps_per_turn));
  };
  ScanRequest request;
  request.first_step = std::max(p.first_step, step(config_.from_deg));
  request.last_step = std::min(p.last_step, step(config_.to_deg));
  request.cluster = config_.cluster;
  request.intensities = config_.intensities;
  request.several_echoes = config_.several_echoes;
  request.continuous = true;
  request.skipped = config_.skipped;
  return request;
}

std::vector<std::pair<std::string_view, std::uint64_t>> Client::counts() const {
  return {{"replies_received", replies_},
          {"scans_read", scans_read_},
          {"scans_lost", scans_lost_},
          {"replies_too_long", reader_.too_long()},
          {"replies_bad_status", bad_status_},
          {"replies_bad_checksum", bad_checksum_},
          {"replies_bad_characters", bad_characters_},
          {"replies_bad_length", bad_length_},
          {"replies_unexpected", unexpected_},
          {"answers_missing", timeouts_},
          {"device_faults", faults_},
          {"restarts", restarts_},
          {"clock_steps", steps_before_ + (clock_ ? clock_->steps() : 0)}};
}

}  // namespace zloam::driver::scip
