#pragma once
// Why a sweep's result is less than usual; same values as the messages' enum (schemas/common.fbs).

#include <cstdint>

namespace zloam {

/// What is asked of a pose: a direction is degenerate when the points leave it open by more than a
/// share of this much way (1 %: 0.1 m), a turn when by more than that share of a radian.
inline constexpr double kJudgedWay_m = 10.0;

enum class Health : std::uint8_t {
  kOk = 0,
  kEmpty = 1,         ///< no point came
  kTooFewPoints = 2,  ///< some came, too few to match
  kIncomplete = 3,    ///< the source lost part of the sweep
  kDegenerate = 4,    ///< a direction is known worse than asked for
  kPredicted = 5,     ///< the pose is the prediction alone
  kDropped = 6,
  kInvalid = 7,
  kBridging = 8,  ///< the odometry's frame was broken off, the new one is being matched
  kLost = 9,
};

}  // namespace zloam
