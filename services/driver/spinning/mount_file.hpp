#pragma once
// Describes a scanner on a motor: a separate file, like the calibration of a many-beam lidar. YAML,
// all keys optional unless marked:
//
//   scanner:
//     rpy_deg: [0, 0, 0]     # of the scanner in the frame that the motor rotates
//     xyz_m: [0, 0, 0]       # its position there
//     from_deg: -135         # measured directions, counter-clockwise from its front
//     to_deg: 135
//     intensities: true
//     several_echoes: false  # up to three per beam
//     sweep_s: 0.1           # lines of this much time are one sweep; 0.02 to 3.9
//   motor:
//     axis: [1, 0, 0]        # in the lidar's frame, through its origin
//     zero_deg: 0            # the encoder's angle where the scan plane is level
//     backward: false        # it counts against a right-handed rotation about the axis
//     delay_ms: 0            # of the angles' stamps against the lines'
//     turn_s: 1.0            # shows all directions once: -90 to 90 degrees, or half a revolution
//     profile:               # instead of readings, for a motor that runs by the host's clock
//       from_s: 1764000000   # Unix time at which it rests at -amplitude, or is at zero; required
//       speed_deg_s: 180     # required
//       amplitude_deg: 90    # of a swing, to either side; omitted: continuous rotation
//       reversal_s: 0.06     # from full speed in one direction to full speed in the other

#include <string>

#include "driver/scip/client.hpp"
#include "driver/spinning/sweeps.hpp"

namespace zloam::driver::spinning {

/// Sets the fields that the text contains. Throws std::invalid_argument that names the key.
void read_mount(const std::string& text, scip::ClientConfig& client, SpinningConfig& spinning);

/// The same as text with all keys, except motor.profile.
std::string mount_text(const scip::ClientConfig& client, const SpinningConfig& spinning);

}  // namespace zloam::driver::spinning
