"""Bags of ROS 1 and 2, MCAP files and folders of clouds, as sweeps for the driver.

The other end of the pipe is services/driver/io/recording.hpp.

bags     messages of a file, by the library `rosbags`
folders  a file a cloud: PCD, PLY, LAS, LAZ
fields   a PointCloud2's bytes to columns of numbers
times    which instant each point is of: unit and origin, settled from the data or refused
rings    which laser each point is of
sweeps   clouds to the driver's sweeps
stream   frames into the pipe
"""


class Refused(RuntimeError):
    """The recording can't be used; the text names topic and field, and what would settle it."""
