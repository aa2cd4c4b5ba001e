#include "driver/scip/reply_reader.hpp"

#include <utility>

namespace zloam::driver::scip {
namespace {

// An echo with its string has 33 characters, a data line 65; texts of VV and II are longer, but
// below this.
constexpr std::size_t kMostCharacters = 512;
// The longest scan has 338 lines: 1081 steps of three echoes with intensities.
constexpr std::size_t kMostLines = 2048;

}  // namespace

void ReplyReader::add(std::span<const std::uint8_t> bytes, std::int64_t received_ns) {
  for (const std::uint8_t byte : bytes) {
    if (byte == '\n') {
      end_line(received_ns);
      continue;
    }
    if (line_.empty() && open_.lines.empty()) open_.begun_ns = received_ns;
    line_ += static_cast<char>(byte);
    if (line_.size() > kMostCharacters) {
      // Keeps one character, so that the next empty line still ends this reply.
      line_.resize(1);
      skipping_ = true;
    }
  }
}

void ReplyReader::end_line(std::int64_t received_ns) {
  if (line_.ends_with('\r')) line_.pop_back();
  if (!line_.empty()) {
    skipping_ = skipping_ || open_.lines.size() == kMostLines;
    if (!skipping_) open_.lines.push_back(std::move(line_));
    line_.clear();
    return;
  }
  if (skipping_) ++too_long_;
  if (!skipping_ && !open_.lines.empty()) {
    open_.received_ns = received_ns;
    whole_.push_back(std::move(open_));
  }
  skipping_ = false;
  open_ = {};
}

std::optional<RawReply> ReplyReader::take() {
  if (whole_.empty()) return std::nullopt;
  RawReply reply = std::move(whole_.front());
  whole_.pop_front();
  return reply;
}

void ReplyReader::clear() {
  line_.clear();
  open_ = {};
  whole_.clear();
  skipping_ = false;
}

}  // namespace zloam::driver::scip
