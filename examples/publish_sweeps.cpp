// Publishes sweeps of a lidar that the driver does not know: put yours in place of revolution().
// usage: zloam-example-sweeps ENDPOINT ROBOT SENSOR COUNT
#include <chrono>
#include <cmath>
#include <numbers>
#include <string>
#include <thread>

#include "common/messages/build.hpp"
#include "common/messages/keys.hpp"
#include "common/zenoh/zenoh.hpp"

constexpr int kRings = 16, kColumns = 900;
constexpr std::int64_t kPeriodNs = 100'000'000;

/// Points in time order, of a sensor that drives at 0.3 m/s through a room of 12 x 9 x 4 m.
zloam::PointVector revolution(int number) {
  zloam::PointVector points;
  for (int i = 0; i < kRings * kColumns; ++i) {
    const double turned = static_cast<double>(i / kRings) / kColumns;
    const double azimuth = -2.0 * std::numbers::pi * (turned + 1e-6);
    const double elevation = (2.0 * (i % kRings) - 15.0) * std::numbers::pi / 180.0;
    const Eigen::Array3d way(std::cos(azimuth), std::sin(azimuth), std::tan(elevation));
    const Eigen::Array3d from_m(0.3 * (number + turned) * kPeriodNs * 1e-9, 0.0, 0.0);
    const Eigen::Array3d to_walls = (way.sign() * Eigen::Array3d(6.0, 4.5, 2.0) - from_m) / way;
    const Eigen::Array3f p = (way * to_walls.minCoeff()).cast<float>();
    points.push_back({p.x(), p.y(), p.z(), 0.0F, static_cast<std::uint32_t>(turned * kPeriodNs),
                      static_cast<std::uint16_t>(i % kRings), zloam::ReturnType::kStrongest, 0});
  }
  return points;
}

int main(int argc, char** argv) {
  if (argc != 5) return 2;
  auto config = zloam::zenoh::Config::create_default();
  config.insert_json5("connect/endpoints", "[\"" + std::string(argv[1]) + "\"]");
  // A program that scouts links all robots which it hears on the network into one.
  config.insert_json5("scouting/multicast/enabled", "false");
  auto session = zloam::zenoh::Session::open(config);
  const std::string key = zloam::Keys(argv[2], argv[3]).of(zloam::Key::kSweep);
  auto publisher =
      session.declare_publisher(key, {.encoding = zloam::encoding_of(zloam::Key::kSweep)});
  using namespace std::chrono;
  while (!publisher.matching()) std::this_thread::sleep_for(milliseconds(100));
  const auto start = system_clock::now();
  // The name of this start, and here its first stamp as well.
  const std::int64_t run = nanoseconds(start.time_since_epoch()).count();
  for (int n = 0; n < std::stoi(argv[4]); ++n) {
    std::this_thread::sleep_until(start + nanoseconds((n + 1) * kPeriodNs));
    const zloam::PointVector points = revolution(n);
    zloam::HeaderFields header;
    header.robot = argv[2], header.sensor = argv[3], header.frame = "lidar",
    header.instance = "my-driver";
    header.run = static_cast<std::uint64_t>(run), header.stamp_ns = run + n * kPeriodNs;
    header.sweep = header.seq = static_cast<std::uint64_t>(n);
    zloam::SweepFields sweep;
    sweep.points = points, sweep.period_ns = kPeriodNs, sweep.rings = kRings;
    publisher.put(zloam::zenoh::Bytes::own(zloam::build(header, sweep)));
  }
  std::this_thread::sleep_for(seconds(1));  // for what is on its way
}
