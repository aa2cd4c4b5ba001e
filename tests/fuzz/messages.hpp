#pragma once
// Makes messages of every schema from a fuzzer's bytes: well-formed and close to those of a stage,
// with some values replaced by the fuzzer's, and in some messages bytes changed as if in transit.

#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

namespace zloam::fuzz {

/// Yields the fuzzer's bytes in order, and zeros after their end.
class Input {
 public:
  explicit Input(std::span<const std::uint8_t> bytes) : bytes_(bytes) {}
  bool ended() const { return at_ >= bytes_.size(); }
  std::uint8_t byte() { return ended() ? 0 : bytes_[at_++]; }
  std::uint64_t word();
  std::string text(std::size_t at_most);

 private:
  std::span<const std::uint8_t> bytes_;
  std::size_t at_ = 0;
};

class MessageMaker {
 public:
  /// folder: contains the schemas in binary form (flatc --schema -b)
  explicit MessageMaker(const std::string& folder);
  ~MessageMaker();
  /// Makes a message of the schema's root table. Repeated calls advance a drive through a room.
  std::vector<std::uint8_t> make(const std::string& schema, Input& input);
  /// Starts the drive again.
  void restart();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace zloam::fuzz
