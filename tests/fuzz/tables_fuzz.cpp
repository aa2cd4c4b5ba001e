// Reads tables that other programs write: IMU readings, times of scans.
#include <sys/mman.h>
#include <unistd.h>

#include <cmath>
#include <cstdlib>
#include <string>

#include "driver/io/imu_file.hpp"
#include "driver/io/packet_source.hpp"
#include "driver/io/scan_list.hpp"

using namespace zloam::driver;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const int fd = memfd_create("table", 0);
  if (fd < 0 || write(fd, data, size) != static_cast<ssize_t>(size)) std::abort();
  const std::string path = "/proc/self/fd/" + std::to_string(fd);
  try {
    const auto readings = read_imu_file(path);
    for (const auto& r : readings) {
      if (!r.rate_radps.allFinite() || !r.force_mps2.allFinite()) std::abort();
    }
    standstill_in(readings);
  } catch (const SourceError&) {
  }
  for (const std::size_t columns : {1U, 2U}) {
    try {
      const auto times_ns = read_times(path, columns, 0.1);
      for (std::size_t i = columns; i < times_ns.size(); i += columns) {
        if (times_ns[i] <= times_ns[i - columns]) std::abort();
      }
    } catch (const SourceError&) {
    }
  }
  close(fd);
  return 0;
}
