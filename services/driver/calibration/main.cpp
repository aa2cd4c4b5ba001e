// zloam-calibrate: computes the mount file for driver.metadata from a recorded session of a scanner
// on a motor, with the platform at rest.

#include <CLI/CLI.hpp>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <filesystem>
#include <iostream>
#include <string>
#include <utility>
#include <vector>

#include "driver/calibration/mount_calibration.hpp"
#include "driver/io/packet_source.hpp"
#include "driver/io/scip_link.hpp"
#include "driver/io/scip_source.hpp"
#include "driver/spinning/mount_file.hpp"

namespace zloam::driver::calibration {
namespace {

constexpr int kNotFound = 1, kUsage = 2, kUnreadable = 3;

struct Options {
  std::string session, angles, mount;
  double seconds = 60.0;
  /// as in deploy/robots/hokuyo.yaml, so that the delay found is the encoder's alone
  double stamp_offset_us = -2000.0;
};

ScipSourceConfig configured(const Options& options) {
  ScipSourceConfig config = read_mount_file(options.mount);
  if (config.spinning.profile) {
    throw SourceError(options.mount +
                      ": motor.profile takes the place of readings, but calibration needs those of "
                      "an encoder: take the section out");
  }
  config.client.asks = false;
  config.client.stamp_offset_ns = std::llround(1e3 * options.stamp_offset_us);
  return config;
}

/// Seconds since the Unix epoch, as text.
std::string span(std::int64_t first_ns, std::int64_t last_ns) {
  std::array<char, 80> text{};
  std::snprintf(text.data(), text.size(), "%.3f to %.3f s", 1e-9 * static_cast<double>(first_ns),
                1e-9 * static_cast<double>(last_ns));
  return text.data();
}

/// Throws SourceError if no angle belongs to a line. delay_ns: of the angles' stamps, as far as it
/// is known.
void check_times(const Recording& recording, const std::string& session, const std::string& angles,
                 std::int64_t delay_ns) {
  const std::int64_t first_ns = recording.lines.front().stamp_ns;
  const std::int64_t last_ns = recording.lines.back().stamp_ns;
  const std::int64_t first_angle_ns = recording.angles.first().stamp_ns;
  const std::int64_t last_angle_ns = recording.angles.last().stamp_ns;
  if (first_ns + delay_ns <= last_angle_ns && first_angle_ns <= last_ns + delay_ns) return;
  throw SourceError("the angles of " + angles + " (" + span(first_angle_ns, last_angle_ns) +
                    ") and the lines of " + session + " (" + span(first_ns, last_ns) +
                    ") do not overlap in time: are they of different recordings, or stamped by "
                    "different clocks?");
}

/// From the first to the last line.
double seconds_of(const Recording& recording) {
  if (recording.lines.empty()) return 0.0;
  return 1e-9 *
         static_cast<double>(recording.lines.back().stamp_ns - recording.lines.front().stamp_ns);
}

void say(const std::string& text) { std::cerr << "zloam-calibrate: " << text << "\n"; }

void read_lines(const Options& options, const scip::ClientConfig& config, Recording& recording) {
  scip::Client client(config);
  client.connected(0);
  const auto link = open_scip_session(options.session);
  std::vector<std::uint8_t> bytes;
  std::int64_t received_ns = 0;
  const auto take = [&] {
    while (auto scan = client.take_scan()) recording.lines.push_back(std::move(*scan));
  };
  while (seconds_of(recording) <= options.seconds &&
         link->read(bytes, received_ns, 0) == ScipLink::Read::kBytes) {
    client.add(bytes, received_ns);
    take();
  }
  client.flush();
  take();
  for (const std::string& remark : client.remarks()) say(options.session + ": " + remark);
  if (!link->why().empty()) say(link->why());
  if (!client.parameters()) {
    throw SourceError(options.session +
                      ": holds no reply to PP, without which no scan can be used");
  }
  if (recording.lines.empty()) throw SourceError(options.session + ": holds no usable scan");
  recording.scanner = *client.parameters();
}

std::string angles_of(const Options& options) {
  if (!options.angles.empty()) return options.angles;
  const std::filesystem::path beside =
      std::filesystem::path(options.session).replace_extension(".csv");
  if (std::filesystem::is_regular_file(beside)) return beside.string();
  throw SourceError(options.session +
                    ": the motor's angles are missing, a table with t_ns and angle_rad in " +
                    beside.string() + " or in the file of --angles");
}

Recording read(const Options& options, const ScipSourceConfig& config) {
  Recording recording;
  read_lines(options, config.client, recording);
  const std::string angles = angles_of(options);
  for (const spinning::AngleReading& reading : read_angle_file(angles)) {
    recording.angles.add(reading);
  }
  if (const std::uint64_t refused = recording.angles.refused(); refused > 0) {
    say(angles + ": readings that are not later than the one before are left out: " +
        std::to_string(refused));
  }
  check_times(recording, options.session, angles, config.spinning.mount.angle_delay_ns);
  return recording;
}

/// told: config is that of a file, not the defaults. Throws SourceError.
void print(const MountCalibration& found, ScipSourceConfig config, bool told) {
  if (!found.objection.empty()) std::printf("# NOT CALIBRATED: %s\n", found.objection.c_str());
  std::printf("# %.0f %% of the points on %zu planes, %.1f mm thick before, %.1f mm after\n",
              100.0 * found.flat_share, found.planes, 1e3 * found.before_m, 1e3 * found.after_m);
  std::printf(
      "# One sigma across the motor's axis: %.4f and %.4f degrees, %.4f and %.4f m; delay: %.3f "
      "ms.\n# No recording determines motor.axis, motor.zero_deg, motor.backward and the scanner's "
      "place along the axis, nor motor.turn_s and the scanner's other keys: here %s. With a wrong "
      "motor.backward, pitch and z have the wrong sign.\n",
      found.pitch_deg.sigma, found.yaw_deg.sigma, found.y_m.sigma, found.z_m.sigma,
      found.delay_ms.sigma, told ? "as in the file of --mount" : "assumed (there is no --mount)");
  config.spinning.mount = found.mount;
  std::fputs(spinning::mount_text(config.client, config.spinning).c_str(), stdout);
  if (std::fflush(stdout) != 0 || std::ferror(stdout) != 0) {
    throw SourceError("standard output: the result can't be written");
  }
}

/// The conditions are written so that NaN fails them.
void check(const Options& options) {
  if (!(options.seconds > 0.0)) throw CLI::ValidationError("--seconds", "more than 0 is expected");
  if (!(std::abs(options.stamp_offset_us) <= 1e6)) {
    throw CLI::ValidationError("--stamp-offset-us", "-1e6 to 1e6 is expected");
  }
}

Options parse(int argc, char** argv) {
  Options options;
  CLI::App app(
      "estimates the pose of a scanner on its motor, and the delay of the motor's angles, from a "
      "recorded session of a platform at rest",
      "zloam-calibrate");
  app.footer(
      "The result is a file for driver.metadata. Exit codes: 0 found; 1 the recording does not "
      "determine all values; 2 wrong command line; 3 a file can't be used or written.");
  app.add_option("SESSION", options.session, "the scanner's replies as they were received")
      ->required();
  app.add_option("--angles", options.angles,
                 "the motor's angles; default: the .csv beside the session");
  app.add_option("--mount", options.mount,
                 "mount file with what is known: the motor's axis, zero and direction, the "
                 "scanner's nominal pose; all of it is printed again with the values found");
  app.add_option("--seconds", options.seconds, "seconds of the session that are used")
      ->capture_default_str();
  app.add_option("--stamp-offset-us", options.stamp_offset_us,
                 "driver.stamp_offset_us of the robot's file: the delay found holds for this value")
      ->capture_default_str();
  app.set_version_flag("--version", "zloam-calibrate " ZLOAM_VERSION);
  try {
    app.parse(argc, argv);
    check(options);
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
    const auto config = configured(options);
    const MountCalibration found = calibrate(read(options, config), config.spinning.mount);
    print(found, config, !options.mount.empty());
    if (found.objection.empty()) return 0;
    say(found.objection);
    return kNotFound;
  } catch (const std::exception& error) {
    say(error.what());
    return kUnreadable;
  }
}
