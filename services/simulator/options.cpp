#include "simulator/options.hpp"

#include <CLI/CLI.hpp>
#include <array>
#include <charconv>
#include <cmath>
#include <functional>
#include <iostream>
#include <map>
#include <numbers>
#include <vector>

namespace zloam::simulator {
namespace {

constexpr int kUsageError = 2;
// Three years: in nanoseconds it is far from the greatest number.
constexpr double kLongest_s = 1e8;

// Command line values that are converted after parsing.
struct Raw {
  std::string mode = "strongest";
  std::string motor = "swing";
  std::array<double, 3> scanner_xyz{};
  std::array<double, 3> scanner_rpy_deg{};
  std::string duration = "full";
  std::string epoch;
  std::array<double, 3> mount_xyz{};
  std::array<double, 3> mount_rpy_deg{};
  std::array<double, 3> shift{};
  double turn_deg = 0.0;
  double range_bias_mm = 0.0;
  std::string udp;
  std::array<double, 2> imu_noise{ImuConfig{}.gyro.noise, ImuConfig{}.accelerometer.noise};
  std::array<double, 2> imu_bias{ImuConfig{}.gyro.bias, ImuConfig{}.accelerometer.bias};
  std::array<double, 2> imu_walk{ImuConfig{}.gyro.walk, ImuConfig{}.accelerometer.walk};
  std::array<double, 3> imu_xyz{};
  std::array<double, 3> imu_rpy_deg{};
  bool imu_ideal = false;
  std::vector<double> clock_step_at_s, clock_step_s;
};

void add_world_options(CLI::App& app, Options& o, Raw& raw) {
  app.add_option("--world", o.world, "Name of a world, see --list-worlds, or a .yaml file")
      ->capture_default_str();
  app.add_option("--seed", o.simulation.seed, "Seed of all random values")->capture_default_str();
  app.add_option("--duration", raw.duration,
                 "Seconds, or 'full' for the whole motion; after it the platform stands still")
      ->capture_default_str();
  app.add_option("--speed-factor", o.scene.speed_factor, "Factor of the maximum speed")
      ->check(CLI::Range(0.05, 3.0))
      ->capture_default_str();
  app.add_flag("--still", o.still, "Keep the platform at its start");
  app.add_option("--laps", o.scene.laps, "Laps of a closed path, without a stop")
      ->check(CLI::Range(1, 100))
      ->capture_default_str();
  app.add_option("--heading-deg", o.scene.heading_deg,
                 "Rotate the platform against its path, so that walls are oblique to its axes")
      ->capture_default_str();
  app.add_option("--turn-deg", raw.turn_deg, "Rotate world and truth about the vertical")
      ->capture_default_str();
  app.add_option("--shift", raw.shift, "Shift world and truth: x y z in m");
  app.add_option("--mount-xyz", raw.mount_xyz, "Position of the lidar in base_link: x y z in m");
  app.add_option("--mount-rpy-deg", raw.mount_rpy_deg, "Its roll pitch yaw in degrees");
  app.add_option("--epoch", raw.epoch, "UTC at the start, default 2024-01-01T00:00:10");
}

void add_sensor_options(CLI::App& app, Options& o, Raw& raw) {
  SensorConfig& s = o.simulation.sensor;
  app.add_option("--mode", raw.mode, "Return mode")
      ->check(CLI::IsMember({"strongest", "last", "dual"}))
      ->capture_default_str();
  app.add_option("--rpm", s.rotation_rpm, "Revolutions per minute")
      ->check(CLI::Range(300.0, 1200.0))
      ->capture_default_str();
  app.add_option("--start-azimuth-deg", s.start_azimuth_deg, "Rotor's angle at the start")
      ->capture_default_str();
  app.add_option("--speed-deviation", s.speed_deviation, "Relative variation of the motor's speed")
      ->capture_default_str();
  app.add_option("--noise", s.noise_sigma_m, "Range noise, 1 sigma, m")->capture_default_str();
  app.add_option("--dropout", s.dropout, "Share of the returns that are lost")
      ->capture_default_str();
  app.add_option("--min-range", s.min_range_m, "m")->capture_default_str();
  app.add_option("--max-range", s.max_range_m, "m")->capture_default_str();
  app.add_option("--detection", s.detection_reflectivity,
                 "Reflectivity in percent that is just detected at the greatest range; 0: "
                 "everything is detected")
      ->capture_default_str();
  app.add_option("--range-bias-mm", raw.range_bias_mm,
                 "Constant range error of each laser, drawn from the seed, 1 sigma")
      ->check(CLI::Range(0.0, 1000.0))
      ->capture_default_str();
  app.add_option("--divergence-mrad", s.divergence_mrad,
                 "Full beam angle; above 0: mixed pixels, and second returns in mode dual")
      ->capture_default_str();
}

void add_scanner_options(CLI::App& app, Options& o, Raw& raw) {
  MotorConfig& m = o.scanner.motor;
  app.add_option("--session", o.scanner_files.session,
                 "File of the scanner's replies as they were received, for driver.source scip_log");
  app.add_option("--angles", o.scanner_files.angles, "The motor's angles, CSV");
  app.add_option("--scanner-noise", o.scanner.noise_sigma_m, "Its range noise, 1 sigma, m")
      ->capture_default_str();
  app.add_option("--scanner-xyz", raw.scanner_xyz,
                 "Position of the scanner on the rotating part: x y z in m");
  app.add_option("--scanner-rpy-deg", raw.scanner_rpy_deg, "Its roll pitch yaw in degrees");
  app.add_option("--motor", raw.motor, "swing: back and forth; turn: continuously; still: at rest")
      ->check(CLI::IsMember({"swing", "turn", "still"}))
      ->capture_default_str();
  app.add_option("--motor-speed", m.speed_deg_s, "Degrees a second")->capture_default_str();
  app.add_option("--motor-amplitude-deg", m.amplitude_deg, "Amplitude of a swing, to either side")
      ->capture_default_str();
  app.add_option("--motor-still-deg", m.still_deg, "Angle of a motor at rest")
      ->capture_default_str();
  app.add_option("--encoder-rate", m.encoder_hz, "Readings of the encoder a second")
      ->capture_default_str();
  app.add_option("--encoder-step-deg", m.encoder_step_deg, "Step of the encoder, degrees")
      ->capture_default_str();
  app.add_option("--encoder-delay", m.encoder_delay_s, "Delay of the encoder's stamps, s")
      ->capture_default_str();
}

void add_outputs(CLI::App& app, Options& o) {
  app.add_option("--truth", o.truth, "Trajectory of the lidar, TUM, 200 Hz");
  app.add_option("--truth-base", o.truth_base, "Trajectory of base_link, TUM, 200 Hz");
  app.add_option("--truth-sweeps", o.truth_sweeps,
                 "Pose of the lidar each time the rotor passes 0 degrees, TUM");
  app.add_option("--imu", o.imu, "Inertial measurements, CSV");
  app.add_option("--threads", o.threads, "Threads; the output does not depend on it")
      ->check(CLI::Range(1, 64))
      ->capture_default_str();
  app.add_flag("--quiet", o.quiet, "No progress line");
}

void add_packet_outputs(CLI::App& app, Options& o, Raw& raw) {
  app.add_option("--out", o.pcap, "Capture file (pcap)");
  app.add_flag("--nanoseconds", o.nanoseconds, "Capture file with nanosecond stamps");
  app.add_option("--bin", o.payloads, "File of bare data payloads, one after the other");
  app.add_option("--returns", o.returns, "All returns as they were encoded, CSV (large)");
  app.add_option("--udp", raw.udp, "Send live to ADDRESS or ADDRESS:PORT");
  app.add_option("--udp-position-port", o.udp_position_port, "Port of the position packets")
      ->capture_default_str();
  app.add_option("--rate", o.rate, "Speed of sending against real time")
      ->check(CLI::Range(0.01, 1000.0))
      ->capture_default_str();
}

void add_zenoh_options(CLI::App& app, Options& o) {
  ZenohSinkConfig& z = o.zenoh_config;
  app.add_flag("--zenoh", o.zenoh,
               "Publish live on lidar/<sensor>/packets, for driver.source zenoh");
  app.add_flag("--zenoh-imu", o.zenoh_imu, "Publish the IMU readings on imu/<sensor> as well");
  app.add_option("--robot", z.robot, "Name of the robot in the keys")->capture_default_str();
  app.add_option("--sensor", z.sensor, "Name of the sensor in the keys")->capture_default_str();
  app.add_option("--zenoh-base-port", z.base_port,
                 "zenoh.base_port of the robot's file; 0: no listening port")
      ->check(CLI::Range(0, 65500))
      ->capture_default_str();
  app.add_option("--zenoh-listen", z.listen, "Endpoints to listen on instead of the default port");
  app.add_option("--zenoh-connect", z.connect, "Further endpoints to connect to");
  app.add_flag("--zenoh-block", z.block, "Wait for a slow reader instead of dropping messages");
  app.add_option("--zenoh-wait", z.wait_s, "Seconds to wait for a first reader")
      ->check(CLI::Range(0.0, 86400.0))
      ->capture_default_str();
}

void add_imu_options(CLI::App& app, Options& o, Raw& raw) {
  app.add_option("--imu-rate", o.imu_config.rate_hz, "Readings of the IMU a second")
      ->check(CLI::Range(1.0, 10000.0))
      ->capture_default_str();
  app.add_option("--imu-noise", raw.imu_noise,
                 "Noise densities of gyro (rad/s/sqrt(Hz)) and accelerometer (m/s^2/sqrt(Hz))")
      ->capture_default_str();
  app.add_option("--imu-bias", raw.imu_bias,
                 "Constant biases, 1 sigma: gyro (rad/s) and accelerometer (m/s^2)")
      ->capture_default_str();
  app.add_option("--imu-walk", raw.imu_walk,
                 "Random walks of the biases: gyro (rad/s/sqrt(s)), accelerometer (m/s^2/sqrt(s))")
      ->capture_default_str();
  app.add_flag("--imu-ideal", raw.imu_ideal, "No noise, no bias");
  app.add_option("--imu-xyz", raw.imu_xyz, "Position of the IMU in base_link: x y z in m");
  app.add_option("--imu-rpy-deg", raw.imu_rpy_deg, "Its roll pitch yaw in degrees");
}

void add_faults(CLI::App& app, Options& o, Raw& raw) {
  FaultConfig& f = o.faults;
  app.add_option("--lose", f.loss, "Probability that a data packet is lost");
  app.add_option("--duplicate", f.duplication, "Probability that a packet is sent twice");
  app.add_option("--delay", f.delay, "Probability that a packet is sent late");
  app.add_option("--delay-packets", f.delay_packets, "Number of packets by which it is late")
      ->capture_default_str();
  app.add_option("--corrupt", f.corruption,
                 "Probability of eight wrong bytes anywhere in a packet");
  app.add_option("--bad-flag", f.bad_flag, "Probability of a wrong flag at one block");
  app.add_option("--azimuth-jump", f.azimuth_jump,
                 "Probability of wrong azimuths from some block to the packet's end");
  app.add_option("--cut", f.wrong_length, "Probability that a packet is cut short");
  app.add_option("--gap-start", f.gap_start_s, "Start of a gap without packets, s");
  app.add_option("--gap", f.gap_s, "Duration of the gap, s");
  app.add_option("--clock-step-at", raw.clock_step_at_s,
                 "Times at which the sensor's clock steps, s ...");
  app.add_option("--clock-step", raw.clock_step_s, "Sizes of these steps, s ...");
  app.add_option("--fault-log", o.fault_log, "CSV of the injected faults and their packets");
}

/// The options that `add` declares.
std::vector<CLI::Option*> added(CLI::App& app, const std::function<void()>& add) {
  const std::size_t before = app.get_options().size();
  add();
  const std::vector<CLI::Option*> all = app.get_options();
  return {all.begin() + static_cast<std::ptrdiff_t>(before), all.end()};
}

/// Declares all options. One that has no effect beside another one is refused, as what it asks for
/// would be missing.
void add_options(CLI::App& app, Options& o, Raw& raw) {
  add_world_options(app, o, raw);
  add_outputs(app, o);
  add_imu_options(app, o, raw);
  CLI::Option* hokuyo = app.add_flag("--hokuyo", o.scans,
                                     "Simulate a Hokuyo UTM-30LX on a motor instead of the VLP-16");
  for (CLI::Option* option : added(app, [&] { add_scanner_options(app, o, raw); })) {
    option->needs(hokuyo);
  }
  for (CLI::Option* option : added(app, [&] {
         add_sensor_options(app, o, raw);
         add_packet_outputs(app, o, raw);
         add_zenoh_options(app, o);
         add_faults(app, o, raw);
       })) {
    option->excludes(hokuyo);
  }
}

double number(const std::string& text, const std::string& what) {
  double value = 0.0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size() || !std::isfinite(value)) {
    throw std::invalid_argument(what + " is not a number: '" + text + "'");
  }
  return value;
}

void convert(const Raw& raw, Options& o) {
  const std::map<std::string, ReturnMode> modes = {{"strongest", ReturnMode::kStrongest},
                                                   {"last", ReturnMode::kLast},
                                                   {"dual", ReturnMode::kDual}};
  const std::map<std::string, MotorKind> motors = {
      {"swing", MotorKind::kSwing}, {"turn", MotorKind::kTurn}, {"still", MotorKind::kStill}};
  o.scanner.motor.kind = motors.at(raw.motor);
  o.scanner.T_motor_scanner = pose_from_xyz_rpy_deg(Eigen::Vector3d(raw.scanner_xyz.data()),
                                                    Eigen::Vector3d(raw.scanner_rpy_deg.data()));
  constexpr double kBeamMrad = 3.0;  // divergence of the VLP-16's beam
  o.simulation.sensor.range_bias_sigma_m = raw.range_bias_mm * 1e-3;
  o.simulation.sensor.mode = modes.at(raw.mode);
  if (raw.mode == "dual" && o.simulation.sensor.divergence_mrad <= 0.0) {
    o.simulation.sensor.divergence_mrad = kBeamMrad;
  }
  if (raw.duration != "full") {
    o.duration_s = number(raw.duration, "--duration");
    if (!(o.duration_s > 0.0 && o.duration_s <= kLongest_s)) {
      throw std::invalid_argument("--duration must be above 0 and at most 1e8, or 'full'");
    }
  }
  if (!raw.epoch.empty()) {
    o.simulation.epoch_ns = parse_utc(raw.epoch);
  }
  o.simulation.T_base_lidar = pose_from_xyz_rpy_deg(Eigen::Vector3d(raw.mount_xyz.data()),
                                                    Eigen::Vector3d(raw.mount_rpy_deg.data()));
  o.simulation.T_truth_world = pose_from_xyz_rpy_deg(Eigen::Vector3d(raw.shift.data()),
                                                     Eigen::Vector3d(0.0, 0.0, raw.turn_deg));
  if (!raw.imu_ideal) {
    o.imu_config.gyro = {raw.imu_noise[0], raw.imu_bias[0], raw.imu_walk[0]};
    o.imu_config.accelerometer = {raw.imu_noise[1], raw.imu_bias[1], raw.imu_walk[1]};
  } else {
    o.imu_config.gyro = o.imu_config.accelerometer = {};
  }
  o.imu_config.T_base_imu = pose_from_xyz_rpy_deg(Eigen::Vector3d(raw.imu_xyz.data()),
                                                  Eigen::Vector3d(raw.imu_rpy_deg.data()));
  o.zenoh = o.zenoh || o.zenoh_imu;
  o.zenoh_config.rate = o.rate;
  o.zenoh_config.batch_ns = std::llround(60e9 / o.simulation.sensor.rotation_rpm);
  o.scene.seed = o.simulation.seed;
  o.faults.seed = o.simulation.seed;
  if (raw.clock_step_at_s.size() != raw.clock_step_s.size()) {
    throw std::invalid_argument("--clock-step-at and --clock-step need as many values");
  }
  for (std::size_t i = 0; i < raw.clock_step_s.size(); ++i) {
    o.faults.clock_steps.push_back({raw.clock_step_at_s[i], raw.clock_step_s[i]});
  }
  const std::size_t colon = raw.udp.find(':');
  o.udp_address = raw.udp.substr(0, colon);
  if (colon == 0) throw std::invalid_argument("--udp needs an address before the port");
  if (colon != std::string::npos) {
    const double port = number(raw.udp.substr(colon + 1), "the port of --udp");
    if (!(port >= 1.0 && port <= 65535.0)) {
      throw std::invalid_argument("the port of --udp must be from 1 to 65535");
    }
    o.udp_port = static_cast<std::uint16_t>(port);
  }
  const bool packets = !o.pcap.empty() || !o.payloads.empty() || !o.returns.empty() ||
                       !o.udp_address.empty() || o.zenoh;
  if (!o.fault_log.empty() && !packets) {
    throw std::invalid_argument(
        "--fault-log needs packets: --out, --bin, --returns, --udp or --zenoh");
  }
}

}  // namespace

std::optional<int> parse_options(int argc, char** argv, Options& options) {
  CLI::App app("Virtual VLP-16 in a virtual world: its packets and the true trajectory",
               "zloam-simulator");
  Raw raw;
  bool list = false;
  app.set_version_flag("--version", std::string("zloam-simulator ") + ZLOAM_VERSION);
  app.add_flag("--list-worlds", list, "Names and descriptions of the worlds");
  add_options(app, options, raw);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? 0 : kUsageError;
  }
  if (list) {
    for (const SceneInfo& info : scene_list()) {
      std::cout << info.name << "\t" << info.description << "\n";
    }
    return 0;
  }
  try {
    convert(raw, options);
  } catch (const std::exception& error) {
    std::cerr << "zloam-simulator: " << error.what() << "\n";
    return kUsageError;
  }
  return std::nullopt;
}

}  // namespace zloam::simulator
