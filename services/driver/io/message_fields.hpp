#pragma once
// Converts a sweep and a position packet to the driver's messages, and a message back to a sweep.

#include "common/messages/build.hpp"
#include "driver/io/sweep_source.hpp"

namespace zloam::driver {

/// All fields but the inertial readings. Points and columns stay the sweep's: it must outlive them.
SweepFields fields_of(const DecodedSweep& sweep);

/// The reverse, for a message that verify() accepted: points and all that fields_of() sets.
DecodedSweep sweep_of(const msg::Sweep& message);

/// With time and place if the sentence has them (RMC); else the sentence alone.
GnssFixFields fields_of(const ReceivedPosition& position);

}  // namespace zloam::driver
