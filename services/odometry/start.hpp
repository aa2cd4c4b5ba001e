#pragma once
// Start of the odometry where nothing is known of the motion: in a street at speed as well as at
// rest.

#include "odometry/matcher.hpp"

namespace zloam::odometry {

/// Whether the points cover a whole revolution, by their times. A source that is opened, or a
/// sensor that is switched on, in the middle of a revolution begins with a part of one: too little
/// to find the second sweep's motion in.
bool covers_turn(const FeatureSweep& sweep);

/// As match_sweep(), started at rest and at speeds to either side along the least constrained
/// direction: in a street the few surfaces across it are further apart than they are wide, and a
/// match started at rest may stay there. Another solution than that from rest is taken only where
/// it explains the points clearly better.
Solution match_at_any_speed(const Source& source, const MotionState& at_rest,
                            const MotionPrior& prior, double period_s, double range_noise_m,
                            const OdometryConfig& config, WindowMap& recent);

}  // namespace zloam::odometry
