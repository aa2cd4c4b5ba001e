#include "simulator/io/parallel.hpp"

#include <thread>

namespace zloam::simulator {

std::vector<DataPacket> data_packets(const Sensor& sensor, std::int64_t first, std::int64_t count,
                                     int threads, std::vector<std::vector<Return>>* returns) {
  std::vector<DataPacket> packets(static_cast<std::size_t>(count));
  if (returns != nullptr) {
    returns->assign(packets.size(), {});
  }
  const auto work = [&](std::int64_t start) {
    for (std::int64_t i = start; i < count; i += threads) {
      const auto slot = static_cast<std::size_t>(i);
      packets[slot] =
          sensor.data_packet(first + i, returns != nullptr ? &(*returns)[slot] : nullptr);
    }
  };
  std::vector<std::jthread> helpers;
  for (int thread = 1; thread < threads; ++thread) {
    helpers.emplace_back(work, thread);
  }
  work(0);
  helpers.clear();  // waits for them
  return packets;
}

}  // namespace zloam::simulator
