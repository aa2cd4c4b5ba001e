#pragma once
// What a robot's builder says of a scanner on a motor: a file of its own, as the calibration of a
// many-beam lidar is. YAML, all of it optional:
//
//   scanner:
//     rpy_deg: [0, 0, 0]     # of the scanner in what the motor turns
//     xyz_m: [0, 0, 0]       # its place there
//     from_deg: -135         # directions that are measured, counter-clockwise from its front
//     to_deg: 135
//     intensities: true
//     several_echoes: false  # up to three of a beam
//     sweep_s: 0.1           # lines of so much time are one sweep
//   motor:
//     axis: [1, 0, 0]        # in the lidar's frame, through its origin
//     zero_deg: 0            # what the encoder tells where the scan plane is level
//     backward: false        # it counts against a right-handed turn about the axis
//     delay_ms: 0            # of the angles' stamps against the lines'
//     turn_s: 1.0            # shows all directions once: from -90 to 90 degrees, or half a turn
//     profile:               # instead of readings, of a motor that runs by the host's clock
//       from_s: 1764000000   # Unix time at which it rests at -amplitude, or is at zero; needed
//       speed_deg_s: 180     # needed
//       amplitude_deg: 90    # of a swing, to either side; left out: it turns on and on
//       reversal_s: 0.06     # from full speed one way to full speed the other way

#include <string>

#include "driver/scip/client.hpp"
#include "driver/spinning/sweeps.hpp"

namespace zloam::driver::spinning {

/// Fills in what the text says. Throws std::invalid_argument that names the key.
void read_mount(const std::string& text, scip::ClientConfig& client, SpinningConfig& spinning);

}  // namespace zloam::driver::spinning
