#pragma once
// Whether a pose can be reached from the ones accepted before it. Finite and well formed is not
// enough: a pose that is 1000 m away after a tenth of a second is nobody's. What keeps coming and
// fits itself is believed after all: then it is the stage, not a stranger, that is wrong.

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
  /// point of the pose's child frame that is compared, where the pose is a transform of frames.
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
