"""Reads bags of ROS 1 and 2, MCAP files and folders of clouds as sweeps for the driver.

The other end of the pipe is services/driver/io/recording.hpp.

bags       messages of a bag, by the library `rosbags`
parts      bags whose files are compressed as wholes
folders    one cloud per file: PCD, PLY, LAS, LAZ
robot_log  recordings of `zloam record`
livox      Livox's own message as a cloud
fields     bytes of a PointCloud2 to columns of numbers
times      instant of each point: unit and origin are inferred from the data, or it is refused
rings      ring (laser) of each point
mounting   poses of lidar and IMU from static transforms
sweeps     clouds to the driver's sweeps
stream     frames into the pipe
"""


class Refused(RuntimeError):
    """The recording can't be used; the text names topic and field, and what would resolve it."""


class CutOff(RuntimeError):
    """The recording cannot be read further; the text says why. What was read before is whole."""


def first_line(error: Exception) -> str:
    """Type and beginning of an error of a library, for a text of one line."""
    return f"{type(error).__name__}: {str(error).splitlines()[0] if str(error) else 'no reason'}"
