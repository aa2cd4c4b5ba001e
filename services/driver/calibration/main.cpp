// zloam-calibrate: computes the mount file for driver.metadata from a recorded session of a scanner
// on a motor, with the platform at rest.

#include <CLI/CLI.hpp>
#include <cmath>
#include <cstdio>
#include <exception>
#include <iostream>

#include "driver/calibration/mount_calibration.hpp"
#include "driver/io/packet_source.hpp"
#include "driver/io/scip_link.hpp"
#include "driver/io/scip_source.hpp"

namespace zloam::driver::calibration {
namespace {

constexpr int kNotFound = 1, kUsage = 2, kUnreadable = 3;

struct Options {
  std::string session, angles;
  double seconds = 60.0;
  /// as in deploy/robots/hokuyo.yaml, so that the delay found is the encoder's alone
  double stamp_offset_us = -2000.0;
};

Recording read(const Options& options) {
  Recording recording;
  const std::string angles =
      options.angles.empty() ? angles_beside(options.session) : options.angles;
  for (const spinning::AngleReading& reading : read_angle_file(angles)) {
    recording.angles.add(reading);
  }
  scip::ClientConfig config;
  config.asks = false;
  config.stamp_offset_ns = std::llround(1e3 * options.stamp_offset_us);
  scip::Client client(config);
  client.connected(0);
  const auto link = open_scip_session(options.session);
  std::vector<std::uint8_t> bytes;
  std::int64_t received_ns = 0;
  const auto take = [&] {
    while (auto scan = client.take_scan()) recording.lines.push_back(std::move(*scan));
  };
  const auto enough = [&] {
    return !recording.lines.empty() &&
           1e-9 * static_cast<double>(recording.lines.back().stamp_ns -
                                      recording.lines.front().stamp_ns) >
               options.seconds;
  };
  while (!enough() && link->read(bytes, received_ns, 0) == ScipLink::Read::kBytes) {
    client.add(bytes, received_ns);
    take();
  }
  client.flush();
  take();
  if (!client.parameters()) {
    throw SourceError(options.session +
                      ": holds no reply to PP, without which no scan can be used");
  }
  recording.scanner = *client.parameters();
  return recording;
}

void print(const MountCalibration& found) {
  std::printf("# %.0f %% of the points on %zu planes, %.1f mm thick before, %.1f mm after\n",
              100.0 * found.flat_share, found.planes, 1e3 * found.before_m, 1e3 * found.after_m);
  std::printf("scanner:\n");
  std::printf("  rpy_deg: [0, %.4f, %.4f]  # one sigma: %.4f, %.4f\n", found.pitch_deg.value,
              found.yaw_deg.value, found.pitch_deg.sigma, found.yaw_deg.sigma);
  std::printf("  xyz_m: [0, %.4f, %.4f]  # one sigma: %.4f, %.4f; x: measure it\n", found.y_m.value,
              found.z_m.value, found.y_m.sigma, found.z_m.sigma);
  std::printf("motor:\n  delay_ms: %.3f  # one sigma: %.3f\n", found.delay_ms.value,
              found.delay_ms.sigma);
}

Options parse(int argc, char** argv) {
  Options options;
  CLI::App app(
      "estimates the pose of a scanner on its motor, and the delay of the motor's angles, from a "
      "recorded session of a platform at rest",
      "zloam-calibrate");
  app.footer(
      "The result is a file for driver.metadata. Exit codes: 0 found; 1 the recording does not "
      "determine all values; 2 wrong command line; 3 a file can't be read.");
  app.add_option("SESSION", options.session, "the scanner's replies as they were received")
      ->required();
  app.add_option("--angles", options.angles,
                 "the motor's angles; default: the .csv beside the session");
  app.add_option("--seconds", options.seconds, "seconds of the session that are used")
      ->capture_default_str();
  app.add_option("--stamp-offset-us", options.stamp_offset_us,
                 "driver.stamp_offset_us of the robot's file: the delay found holds for this value")
      ->capture_default_str();
  app.set_version_flag("--version", "zloam-calibrate " ZLOAM_VERSION);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    std::exit(app.exit(error) == 0 ? 0 : kUsage);
  }
  return options;
}

}  // namespace
}  // namespace zloam::driver::calibration

int main(int argc, char** argv) {
  using namespace zloam::driver::calibration;
  const Options options = parse(argc, argv);
  try {
    const MountCalibration found = calibrate(read(options), {});
    print(found);
    if (found.objection.empty()) return 0;
    std::cerr << "zloam-calibrate: " << found.objection << "\n";
    return kNotFound;
  } catch (const std::exception& error) {
    std::cerr << "zloam-calibrate: " << error.what() << "\n";
    return kUnreadable;
  }
}
