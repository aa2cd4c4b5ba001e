#pragma once
// Writes and reads submaps in this machine's byte order, for repeated runs of the graph over the
// same submaps.

#include <cstdint>
#include <fstream>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "common/geometry/submap.hpp"

namespace zloam::offline {

namespace submap_file {
template <typename T>
void put(std::ofstream& file, const T& value) {
  file.write(reinterpret_cast<const char*>(&value), sizeof value);
}
template <typename T>
void get(std::ifstream& file, T& value) {
  file.read(reinterpret_cast<char*>(&value), sizeof value);
}
}  // namespace submap_file

inline void write_submap(std::ofstream& file, const Submap& s) {
  using submap_file::put;
  for (const std::uint64_t n : {s.first_sweep, s.last_sweep, s.sweep, s.before_sweep}) put(file, n);
  put(file, s.instant_ns);
  const Eigen::Matrix4d T = s.T_map_submap.matrix();
  put(file, T);
  put(file, s.step_covariance);
  put(file, s.step_m);
  put(file, std::uint64_t{s.connected});
  put(file, s.range_noise_m);
  put(file, std::uint64_t{s.points.size()});
  file.write(reinterpret_cast<const char*>(s.points.data()),
             static_cast<std::streamsize>(s.points.size() * sizeof(MapPoint)));
  file.write(reinterpret_cast<const char*>(s.hits.data()),
             static_cast<std::streamsize>(s.points.size() * sizeof(std::uint64_t)));
  put(file, std::uint64_t{s.origins.size()});
  for (const Eigen::Vector3d& origin : s.origins) put(file, origin);
}

inline std::vector<Submap> read_submaps(const std::string& path) {
  using submap_file::get;
  std::ifstream file(path, std::ios::binary);
  if (!file) throw std::runtime_error(path + ": can't be read");
  std::vector<Submap> all;
  while (file.peek() != EOF) {
    Submap s;
    for (std::uint64_t* n : {&s.first_sweep, &s.last_sweep, &s.sweep, &s.before_sweep})
      get(file, *n);
    get(file, s.instant_ns);
    get(file, s.T_map_submap.matrix());
    get(file, s.step_covariance);
    get(file, s.step_m);
    std::uint64_t connected = 0, count = 0;
    get(file, connected);
    s.connected = connected != 0;
    get(file, s.range_noise_m);
    get(file, count);
    s.points.resize(count);
    file.read(reinterpret_cast<char*>(s.points.data()),
              static_cast<std::streamsize>(count * sizeof(MapPoint)));
    s.hits.resize(count);
    file.read(reinterpret_cast<char*>(s.hits.data()),
              static_cast<std::streamsize>(count * sizeof(std::uint64_t)));
    get(file, count);
    s.origins.resize(count);
    for (Eigen::Vector3d& origin : s.origins) get(file, origin);
    if (!file) throw std::runtime_error(path + ": ends in the middle of a submap");
    all.push_back(std::move(s));
  }
  return all;
}

}  // namespace zloam::offline
