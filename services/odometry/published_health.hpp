#pragma once
// Health in the messages of odometry: its own, or the source's where its own is Ok.

#include "common/geometry/health.hpp"

namespace zloam::odometry {

inline Health published_health(Health own, Health source) {
  return own == Health::kOk ? source : own;
}

/// Odometry's own health of a published one; Ok for those that only a source can have. Both call a
/// sweep without points Empty.
inline Health own_health(Health published) {
  switch (published) {
    case Health::kTooFewPoints:
    case Health::kIncomplete:
    case Health::kDropped:
      return Health::kOk;
    case Health::kOk:
    case Health::kEmpty:
    case Health::kDegenerate:
    case Health::kPredicted:
    case Health::kInvalid:
    case Health::kBridging:
    case Health::kLost:
      return published;
  }
  return Health::kOk;
}

}  // namespace zloam::odometry
