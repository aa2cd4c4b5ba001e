#pragma once
// Which sweeps of a run have a known pose in the map. A sweep's cloud comes apart from its pose,
// and without its health.

#include <cstddef>
#include <cstdint>
#include <deque>
#include <optional>
#include <utility>

namespace zloam::ros {

class PlacedSweeps {
 public:
  /// A cloud comes within a few sweeps of its pose.
  static constexpr std::size_t kMost = 64;

  /// The pose of a sweep has come; `placed`: it is known in the map.
  void add(std::uint64_t sweep, bool placed) {
    newest_.emplace_back(sweep, placed);
    if (newest_.size() > kMost) newest_.pop_front();
  }
  void clear() { newest_.clear(); }
  /// Whether the sweep's pose is known; nothing if it may still come.
  std::optional<bool> find(std::uint64_t sweep) const {
    for (const auto& [number, placed] : newest_) {
      if (number == sweep) return placed;
    }
    if (newest_.empty() || sweep > newest_.back().first) return std::nullopt;
    return false;
  }

 private:
  std::deque<std::pair<std::uint64_t, bool>> newest_;
};

}  // namespace zloam::ros
