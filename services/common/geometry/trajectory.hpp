#pragma once
// Trajectories as text files. Numbers only: no wall time, no host, so that equal runs give equal
// bytes.

#include <cstdint>
#include <deque>
#include <string>
#include <string_view>

#include "common/geometry/se3.hpp"

namespace zloam {

struct TrajectoryPose {
  /// the instant the pose holds for, ns since the Unix epoch
  std::int64_t instant_ns = 0;
  Pose T_parent_base = Pose::Identity();
};
/// Grows with every sweep for as long as the robot runs: never copied to make room.
using Trajectory = std::deque<TrajectoryPose>;

/// TUM: "stamp x y z qx qy qz qw" per line, stamp in seconds with nine decimals, quaternion with w
/// >= 0.
std::string tum_line(const TrajectoryPose& pose);

/// KITTI: the upper 3x4 of T_parent_base row by row, twelve numbers per line, in the frame of the
/// poses (not moved so that the first pose is the identity).
std::string kitti_line(const TrajectoryPose& pose);

/// A file's lines in pieces, empty at the end: days of poses are never in memory as text.
class TrajectoryText {
 public:
  using Line = std::string (*)(const TrajectoryPose&);
  TrajectoryText(const Trajectory& poses, Line line) : poses_(poses), line_(line) {}
  /// Valid until the next call.
  std::string_view next();

 private:
  const Trajectory& poses_;
  Line line_;
  std::size_t done_ = 0;
  std::string piece_;
};

}  // namespace zloam
