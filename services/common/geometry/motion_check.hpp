#pragma once
// Whether a pose can be reached from the ones accepted before it. Finite and well formed is not
// enough: a pose 1000 m away after a tenth of a second is implausible. Poses that keep coming and
// are consistent are accepted after all: then a stage is wrong, not a foreign sender.

#include <cstdint>
#include <optional>
#include <string>

#include "common/geometry/se3.hpp"

namespace zloam {

/// Faster and wider than any platform; not a model of one.
struct MotionReach {
  double m = 3.0, m_per_s = 120.0;
  double rad = 0.7, rad_per_s = 20.0;
};

class MotionCheck {
 public:
  explicit MotionCheck(const MotionReach& reach = {}) : reach_(reach) {}

  /// Empty: accepted. Else the reason. frame: poses of different frames are not compared. at: the
  /// point of the pose's child frame that is compared, if the pose is a transform between frames.
  std::string check(std::uint64_t frame, std::int64_t instant_ns, const Pose& pose,
                    const Pose& at = Pose::Identity());
  void reset() { accepted_.reset(), refused_.reset(), refused_in_a_row_ = 0; }

 private:
  struct Entry {
    std::uint64_t frame;
    std::int64_t instant_ns;
    Pose pose;
  };
  std::string error(const Entry& from, const Entry& to, const Pose& at) const;

  MotionReach reach_;
  std::optional<Entry> accepted_, refused_;
  int refused_in_a_row_ = 0;
};

}  // namespace zloam
