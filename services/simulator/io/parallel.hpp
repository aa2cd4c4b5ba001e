#pragma once
// Makes packets with several threads.

#include <cstdint>
#include <vector>

#include "simulator/sensor.hpp"

namespace zloam::simulator {

/// Packets [first, first + count); the same for any number of threads (at least 1). returns, if
/// given, gets one list per packet.
std::vector<DataPacket> data_packets(const Sensor& sensor, std::int64_t first, std::int64_t count,
                                     int threads,
                                     std::vector<std::vector<Return>>* returns = nullptr);

}  // namespace zloam::simulator
