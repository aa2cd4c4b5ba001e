#pragma once
// Recorded inertial readings.

#include <string>
#include <vector>

#include "common/geometry/imu_reading.hpp"

namespace zloam::driver {

/// A table with a line of names and one reading per line, separated by commas, semicolons (then a
/// comma may be the decimal point) or tabs: t_ns (Unix), wx_rad_s, wy_rad_s, wz_rad_s, ax_m_s2,
/// ay_m_s2, az_m_s2, in any order; other columns, comments (#) and empty lines are skipped. Throws
/// SourceError, naming file, line and column.
std::vector<ImuReading> read_imu_file(const std::string& path);

/// A sentence if the readings stop changing; empty: they do not.
std::string standstill_in(const std::vector<ImuReading>& readings);

}  // namespace zloam::driver
