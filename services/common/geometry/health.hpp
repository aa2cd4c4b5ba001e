#pragma once
// Why a sweep's result is limited; same values as the messages' enum (schemas/common.fbs).

#include <cstdint>

namespace zloam {

/// Requirement on a pose: a direction is degenerate when its sigma from the points exceeds a share
/// of this distance (1 %: 0.1 m), a rotation when its sigma exceeds that share of a radian.
inline constexpr double kJudgedWay_m = 10.0;

enum class Health : std::uint8_t {
  kOk = 0,
  kEmpty = 1,         ///< no point arrived
  kTooFewPoints = 2,  ///< some arrived, too few to match
  kIncomplete = 3,    ///< the source lost part of the sweep
  kDegenerate = 4,    ///< a direction is known worse than required
  kPredicted = 5,     ///< the pose is the prediction alone
  kDropped = 6,
  kInvalid = 7,
  kBridging = 8,  ///< the odometry's frame was interrupted, the new one is being matched
  kLost = 9,
};

}  // namespace zloam
