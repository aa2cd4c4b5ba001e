#pragma once
// Why a sweep's result is less than usual; same values as the messages' enum (schemas/common.fbs).

#include <cstdint>

namespace zloam {

enum class Health : std::uint8_t {
  kOk = 0,
  kEmpty = 1,         ///< no point came
  kTooFewPoints = 2,  ///< some came, too few to match
  kIncomplete = 3,    ///< the source lost part of the sweep
  kDegenerate = 4,    ///< at least one direction was kept from the prediction
  kPredicted = 5,     ///< the pose is the prediction alone
  kDropped = 6,
  kInvalid = 7,
  kBridging = 8,  ///< the odometry's frame was broken off, the new one is being matched
  kLost = 9,
};

}  // namespace zloam
