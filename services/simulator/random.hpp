#pragma once
// Counter-based random numbers: a value depends only on its keys (seed, stream, index), never on
// other draws, so that packets can be made in any order and by any number of threads. The mixing
// function is splitmix64 (Steele, Lea, Flood, "Fast splittable pseudorandom number generators",
// OOPSLA 2014).

#include <cmath>
#include <cstdint>
#include <numbers>

namespace zloam::simulator {

inline std::uint64_t mixed(std::uint64_t x) {
  x += 0x9E3779B97F4A7C15ULL;
  x = (x ^ (x >> 30)) * 0xBF58476D1CE4E5B9ULL;
  x = (x ^ (x >> 27)) * 0x94D049BB133111EBULL;
  return x ^ (x >> 31);
}

/// Purpose of a draw. Different streams of one seed are independent.
enum class Stream : std::uint64_t {
  kReturns = 1,
  kWorld,
  kTrajectory,
  kTerrain,
  kFaults,
  kImu,
  kMovers,
  kFoliage
};

/// The sequence of draws that belongs to (seed, stream, index).
class Random {
 public:
  Random(std::uint64_t seed, Stream stream, std::uint64_t index = 0)
      : state_(mixed(mixed(mixed(seed) ^ static_cast<std::uint64_t>(stream)) ^ index)) {}

  std::uint64_t bits() {
    state_ += 0x9E3779B97F4A7C15ULL;
    return mixed(state_);
  }

  /// Uniform in [0, 1).
  double uniform() { return static_cast<double>(bits() >> 11) * 0x1.0p-53; }
  double uniform(double low, double high) { return low + (high - low) * uniform(); }

  /// True with the given probability.
  bool chance(double probability) { return uniform() < probability; }

  /// +1 or -1.
  double sign() { return chance(0.5) ? 1.0 : -1.0; }

  /// Standard normal (Box and Muller; the second value is not kept, so that the count of draws per
  /// number is fixed).
  double normal() {
    const double radius = std::sqrt(-2.0 * std::log(1.0 - uniform()));
    return radius * std::cos(2.0 * std::numbers::pi * uniform());
  }

  /// Normal, cut off at +-limit sigmas.
  double normal(double sigma, double limit) {
    const double z = normal();
    return sigma * (z > limit ? limit : z < -limit ? -limit : z);
  }

 private:
  std::uint64_t state_;
};

}  // namespace zloam::simulator
