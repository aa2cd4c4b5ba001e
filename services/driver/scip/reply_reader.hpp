#pragma once
// Assembles the bytes of a SCIP device to replies, regardless of their fragmentation.

#include <cstdint>
#include <deque>
#include <optional>
#include <span>
#include <string>
#include <vector>

namespace zloam::driver::scip {

/// The lines of one reply, without their ends and without the empty line that closes it.
struct RawReply {
  std::vector<std::string> lines;
  /// when its first and its last byte were received, ns since the Unix epoch; 0: unknown
  std::int64_t begun_ns = 0;
  std::int64_t received_ns = 0;
};

class ReplyReader {
 public:
  void add(std::span<const std::uint8_t> bytes, std::int64_t received_ns);
  /// The oldest whole reply.
  std::optional<RawReply> take();
  /// Drops the open reply: the connection is a new one.
  void clear();
  /// Replies dropped because a line or the reply was longer than any of SCIP's.
  std::uint64_t too_long() const { return too_long_; }

 private:
  void end_line(std::int64_t received_ns);

  std::string line_;
  RawReply open_;
  /// the rest of the open reply is skipped
  bool skipping_ = false;
  std::deque<RawReply> whole_;
  std::uint64_t too_long_ = 0;
};

}  // namespace zloam::driver::scip
