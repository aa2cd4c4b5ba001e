#pragma once
// How the odometry begins where nothing is known of the motion: in a street at speed as well as at
// rest.

#include "odometry/matcher.hpp"

namespace zloam::odometry {

/// Whether the points lie all around, by their times. A source that is opened, or a sensor that is
/// switched on, in the middle of a revolution begins with a piece of one: too little to find the
/// second sweep's motion in.
bool covers_turn(const FeatureSweep& sweep);

/// As match_sweep(), begun at rest and at speeds to either side along the direction that the points
/// hold least: in a street the few surfaces across it are further apart than they are wide, and
/// who begins at rest may stay there. Another one than rest's is taken where it explains the points
/// clearly better.
Solution match_at_any_speed(const Source& source, const MotionState& at_rest,
                            const MotionPrior& prior, double period_s, double range_noise_m,
                            const OdometryConfig& config, WindowMap& recent);

}  // namespace zloam::odometry
