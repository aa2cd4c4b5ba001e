#pragma once
// What the driver's messages say of a sweep and of a position packet, and a sweep read back.

#include "common/messages/build.hpp"
#include "driver/io/sweep_source.hpp"

namespace zloam::driver {

/// All but the inertial readings. Points and columns stay the sweep's: it must outlive the fields.
SweepFields fields_of(const DecodedSweep& sweep);

/// The other way, for a message that verify() found ok: of points and all that fields_of tells.
DecodedSweep sweep_of(const msg::Sweep& message);

/// Time and place where the sentence is one that says them (RMC); else the sentence alone.
GnssFixFields fields_of(const ReceivedPosition& position);

}  // namespace zloam::driver
