#pragma once
// The newest two states of an integration, each with the pose after which it was: beside the journal,
// so that an instance that goes on has learnt what the one before had. Nothing is synced: it survives
// the process, not a power failure. One that was cut short, or changed, is none.

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace zloam::integration {

struct SavedState {
  std::uint64_t run = 0;
  /// of the last pose that had left
  std::uint64_t sweep = 0;
  std::vector<std::uint64_t> words;
};

class StateFile {
 public:
  /// Empty path: none is kept.
  explicit StateFile(const std::string& path);
  ~StateFile() { close(); }
  StateFile(const StateFile&) = delete;
  StateFile& operator=(const StateFile&) = delete;

  /// The newest of the run that is of no later pose.
  std::optional<SavedState> read(std::uint64_t run, std::uint64_t sweep) const;
  /// Begins new files: one who still has the old ones open writes to nobody.
  std::string begin();
  /// Empty, or a sentence that says what failed.
  std::string write(const SavedState& state);
  void remove();

 private:
  void close();
  std::array<std::string, 2> paths_;
  std::array<int, 2> descriptors_{-1, -1};
  std::size_t turn_ = 0;
};

}  // namespace zloam::integration
