#include "simulator/io/parallel.hpp"

#include <atomic>
#include <thread>

namespace zloam::simulator {

std::vector<DataPacket> data_packets(const Sensor& sensor, std::int64_t first, std::int64_t count,
                                     int threads, std::vector<std::vector<Return>>* returns) {
  std::vector<DataPacket> packets(static_cast<std::size_t>(count));
  if (returns != nullptr) {
    returns->assign(packets.size(), {});
  }
  // Each thread takes the next packet when it has finished one, so that none waits for another.
  std::atomic<std::int64_t> next{0};
  const auto work = [&] {
    for (std::int64_t i = next++; i < count; i = next++) {
      const auto slot = static_cast<std::size_t>(i);
      packets[slot] =
          sensor.data_packet(first + i, returns != nullptr ? &(*returns)[slot] : nullptr);
    }
  };
  std::vector<std::jthread> helpers;
  for (int thread = 1; thread < threads; ++thread) {
    helpers.emplace_back(work);
  }
  work();
  helpers.clear();  // waits for them
  return packets;
}

}  // namespace zloam::simulator
