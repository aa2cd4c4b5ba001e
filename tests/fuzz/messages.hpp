#pragma once
// Messages of every schema out of a fuzzer's bytes: well-formed, near to what a stage sends, with
// some values of the fuzzer's own; then, for some, bytes changed on the wire.

#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

namespace zloam::fuzz {

/// The fuzzer's bytes one after another; zeros behind their end.
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
  /// folder: of the schemas in binary form (flatc --schema -b)
  explicit MessageMaker(const std::string& folder);
  ~MessageMaker();
  /// Of the schema's root table. Repeated calls advance a drive through a room.
  std::vector<std::uint8_t> make(const std::string& schema, Input& input);
  /// Begins the drive again.
  void restart();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace zloam::fuzz
