#pragma once
// What the driver's messages say of a sweep and of a position packet.

#include "common/messages/build.hpp"
#include "driver/io/sweep_source.hpp"

namespace zloam::driver {

/// All but the inertial readings. Points and columns stay the sweep's: it must outlive the fields.
SweepFields fields_of(const DecodedSweep& sweep);

/// Time and place where the sentence is one that says them (RMC); else the sentence alone.
GnssFixFields fields_of(const ReceivedPosition& position);

}  // namespace zloam::driver
