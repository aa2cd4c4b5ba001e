#pragma once
// The newest two states of an integration, each with the pose it belongs to, kept beside the
// journal: a restarted instance keeps what was learned. Nothing is synced: the states survive the
// process, not a power failure. A state that was cut short or changed is ignored.

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace zloam::integration {

struct SavedState {
  std::uint64_t run = 0;
  /// of the last pose published
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

  /// The run's newest state whose pose is not later than the sweep.
  std::optional<SavedState> read(std::uint64_t run, std::uint64_t sweep) const;
  /// Starts new files: an instance that still has the old ones open can't write to these.
  std::string begin();
  /// Empty, or a sentence that says what failed, now or at begin(). The next one is tried again.
  std::string write(const SavedState& state);
  void remove();

 private:
  void close();
  std::array<std::string, 2> paths_;
  std::array<int, 2> descriptors_{-1, -1};
  std::size_t turn_ = 0;
  std::string not_begun_;
};

}  // namespace zloam::integration
