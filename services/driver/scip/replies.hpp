#pragma once
// Meaning of a SCIP device's replies. Source: Hokuyo C-42-03320B (pages 10 to 16), and the table of
// the statuses on the maker's wiki.

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <string_view>

#include "driver/scip/reply_reader.hpp"

namespace zloam::driver::scip {

/// The first two lines of every reply.
struct Head {
  /// "MD", "TM1", "%SL": the command in the echo
  std::string command;
  /// the echo's rest, without the string
  std::string parameters;
  /// after a semicolon, up to 16 characters chosen by the host
  std::string user;
  /// two characters
  std::string status;
};

/// Nothing when the reply has less than two lines or its status line is damaged.
std::optional<Head> head_of(const RawReply& reply);

/// Whether this is a reply in SCIP 1, whose status is one character without a checksum.
bool is_of_scip1(const RawReply& reply);

/// Whether a command measures: one scan (GD, GS, GE, HD, HE) or many (MD, MS, ME, ND, NE).
bool measures(std::string_view command);
/// Whether the device did not accept a measuring command, and why is no state of the device itself.
bool is_refusal(const Head& head);
/// Whether the device does not know a command.
bool is_unknown(const Head& head);

/// A sentence for an unexpected status of a command; for any of the table.
std::string meaning(const Head& head);
/// Whether a status reports a fault of the device itself (laser, motor or memory).
bool is_fault(const Head& head);
/// Whether a status says that the device is unstable for now, which is no fault.
bool is_unstable(const Head& head);

/// The lines "NAME:VALUE;X" of VV, PP and II. damaged: lines without their checksum.
std::map<std::string, std::string> values_of(const RawReply& reply, int& damaged);

/// Reply to PP (page 15).
struct Parameters {
  std::string model;
  std::uint32_t least_mm = 0;
  std::uint32_t most_mm = 0;
  int steps_per_turn = 0;
  int first_step = 0;
  int last_step = 0;
  int front_step = 0;
  int turns_per_minute = 0;

  std::int64_t turn_ns() const { return 60'000'000'000 / turns_per_minute; }
  /// From step 0 to this one.
  std::int64_t step_ns(int step) const { return turn_ns() * step / steps_per_turn; }
  /// Counter-clockwise from the front, seen from above.
  double azimuth_rad(int step) const;
};

/// Throws std::invalid_argument that names the line which is missing or invalid.
Parameters parameters_of(const std::map<std::string, std::string>& values);

/// The counter of a TM1 reply, ms; nothing when the line is missing or damaged.
std::optional<std::uint32_t> counter_of(const RawReply& reply);

}  // namespace zloam::driver::scip
