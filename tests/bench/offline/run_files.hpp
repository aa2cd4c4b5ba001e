#pragma once
// What all offline programs share: CPU time, result files, arguments, main().

#include <time.h>

#include <Eigen/Geometry>
#include <cstdint>
#include <cstdio>
#include <exception>
#include <fstream>
#include <stdexcept>
#include <string>
#include <vector>

#include "common/geometry/se3.hpp"

namespace zloam::offline {

/// CPU time of the process so far.
inline double cpu_ms() {
  timespec t{};
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
  return static_cast<double>(t.tv_sec) * 1e3 + static_cast<double>(t.tv_nsec) * 1e-6;
}

/// A file of results, which counts only once finish() has returned.
class ResultFile : public std::ofstream {
 public:
  ResultFile() = default;
  explicit ResultFile(const std::string& path, openmode mode = out) { create(path, mode); }

  void create(const std::string& path, openmode mode = out) {
    path_ = path;
    open(path, mode);
    if (!is_open()) throw std::runtime_error(path_ + ": can't be created");
  }
  /// Of one that was never created: nothing to do. Throws if anything could not be written.
  void finish() {
    if (path_.empty()) return;
    close();
    if (!good()) throw std::runtime_error(path_ + ": can't be written: is the disk full?");
  }

 private:
  std::string path_;
};

/// Adds an argument that is no known option: a misspelt one is no file.
inline void add_positional(std::vector<std::string>& positional, const std::string& argument) {
  if (argument.starts_with("--")) throw std::invalid_argument("no such option: " + argument);
  positional.push_back(argument);
}

/// One line of a TUM file.
inline void write_tum(std::ofstream& file, std::int64_t stamp_ns, const Pose& pose) {
  const Eigen::Quaterniond q(pose.linear());
  char line[256];
  std::snprintf(line, sizeof line, "%lld.%09lld %.9f %.9f %.9f %.12f %.12f %.12f %.12f\n",
                static_cast<long long>(stamp_ns / 1000000000),
                static_cast<long long>(stamp_ns % 1000000000), pose.translation().x(),
                pose.translation().y(), pose.translation().z(), q.x(), q.y(), q.z(), q.w());
  file << line;
}

/// The program's main(): if the run throws, prints the reason and returns 2.
inline int run_main(const char* name, int argc, char** argv,
                    int (*run)(const std::vector<std::string>& args)) {
  try {
    return run(std::vector<std::string>(argv + 1, argv + argc));
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s: %s\n", name, error.what());
    return 2;
  }
}

}  // namespace zloam::offline
