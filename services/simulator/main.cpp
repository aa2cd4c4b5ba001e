// Writes the data of a virtual VLP-16, or of a virtual Hokuyo on a motor, to files or the network,
// and the ground truth to files.

#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <exception>
#include <future>
#include <iostream>
#include <memory>
#include <stdexcept>
#include <vector>

#include "simulator/capture.hpp"
#include "simulator/faults.hpp"
#include "simulator/imu.hpp"
#include "simulator/io/parallel.hpp"
#include "simulator/io/scanner_files.hpp"
#include "simulator/io/scene_file.hpp"
#include "simulator/io/sinks.hpp"
#include "simulator/io/zenoh_sink.hpp"
#include "simulator/options.hpp"
#include "simulator/scenes.hpp"
#include "simulator/sensor.hpp"

namespace zloam::simulator {
namespace {

constexpr int kFailure = 1;
constexpr int kUsageError = 2;
constexpr int kIoError = 3;
constexpr std::int64_t kChunkPackets = 768;  // a second
constexpr double kTruthHz = 200.0;

std::int64_t nanoseconds(double seconds) {
  return static_cast<std::int64_t>(std::llround(seconds * 1e9));
}

// The trajectory's body has its origin at the lidar and the axes of base_link.
Pose T_base_body(const SimulationConfig& config) {
  Pose pose = Pose::Identity();
  pose.translation() = config.T_base_lidar.translation();
  return pose;
}

Imu make_imu(const Options& options, const Sensor& sensor) {
  return {sensor.scene().trajectory, options.imu_config, T_base_body(options.simulation),
          options.simulation.seed};
}

ImuSource imu_source(const Options& options, const Sensor& sensor) {
  if (!options.zenoh_imu) {
    return {};
  }
  return [imu = std::make_shared<Imu>(make_imu(options, sensor))](std::int64_t until_ns) {
    std::vector<ImuReading> readings;
    while (imu->next_time_ns() <= until_ns) {
      readings.push_back(imu->next());
    }
    return readings;
  };
}

std::vector<std::unique_ptr<Sink>> make_sinks(const Options& options, const Sensor& sensor) {
  std::vector<std::unique_ptr<Sink>> sinks;
  if (!options.pcap.empty()) {
    sinks.push_back(pcap_sink(options.pcap, options.nanoseconds));
  }
  if (!options.payloads.empty()) {
    sinks.push_back(payload_sink(options.payloads));
  }
  if (!options.udp_address.empty()) {
    sinks.push_back(
        udp_sink(options.udp_address, options.udp_port, options.udp_position_port, options.rate));
  }
  if (options.zenoh) {
    sinks.push_back(
        zenoh_sink(options.zenoh_config, options.simulation.epoch_ns, imu_source(options, sensor)));
  }
  return sinks;
}

void write_trajectory(const std::string& path, const Sensor& sensor, double duration_s, bool base) {
  if (path.empty()) {
    return;
  }
  OutputFile file(path);
  const auto count = static_cast<std::int64_t>(std::ceil(duration_s * kTruthHz));
  for (std::int64_t i = 0; i <= count; ++i) {
    const double t = static_cast<double>(i) / kTruthHz;
    file.write(tum_line(sensor.config().epoch_ns + nanoseconds(t),
                        base ? sensor.T_truth_base(t) : sensor.T_truth_lidar(t)));
  }
  file.close();
}

void write_sweep_truth(const std::string& path, const Sensor& sensor, double duration_s) {
  if (path.empty()) {
    return;
  }
  OutputFile file(path);
  const double first = std::floor(sensor.rotor_deg(0.0) / 360.0) + 1.0;
  for (double turn = first;; turn += 1.0) {
    const double t = sensor.rotor_time_s(360.0 * turn);
    if (t > duration_s) {
      break;
    }
    file.write(tum_line(sensor.config().epoch_ns + nanoseconds(t), sensor.T_truth_lidar(t)));
  }
  file.close();
}

void write_imu(const Options& options, const Sensor& sensor, double duration_s) {
  if (options.imu.empty()) {
    return;
  }
  OutputFile file(options.imu);
  file.write(
      "t_ns,wx_rad_s,wy_rad_s,wz_rad_s,ax_m_s2,ay_m_s2,az_m_s2,"
      "bias_wx,bias_wy,bias_wz,bias_ax,bias_ay,bias_az\n");
  Imu imu = make_imu(options, sensor);
  while (imu.next_time_ns() <= nanoseconds(duration_s)) {
    const ImuReading reading = imu.next();
    std::string line = std::to_string(sensor.config().epoch_ns + reading.time_ns);
    for (const Eigen::Vector3d& v :
         {reading.rate_rad_s, reading.force_m_s2, reading.gyro_bias, reading.accelerometer_bias}) {
      char text[96];
      std::snprintf(text, sizeof text, ",%.9f,%.9f,%.9f", v.x(), v.y(), v.z());
      line += text;
    }
    file.write(line + "\n");
  }
  file.close();
}

void write_faults(const std::string& path, const std::vector<Fault>& log) {
  if (path.empty()) {
    return;
  }
  OutputFile file(path);
  file.write("packet,fault,detail\n");
  for (const Fault& fault : log) {
    file.write(std::to_string(fault.index) + "," + fault.kind + "," + fault.detail + "\n");
  }
  file.close();
}

class ReturnsFile {
 public:
  explicit ReturnsFile(const std::string& path) {
    if (!path.empty()) {
      file_ = std::make_unique<OutputFile>(path);
      file_->write("packet,block,channel,laser,t_ns,azimuth_deg,range_m,reflectivity,surface\n");
    }
  }
  bool wanted() const { return file_ != nullptr; }
  void write(std::int64_t first, const std::vector<std::vector<Return>>& packets,
             std::int64_t epoch_ns) {
    std::string text;
    for (std::size_t i = 0; i < packets.size(); ++i) {
      const auto packet = static_cast<long long>(i) + first;
      for (const Return& r : packets[i]) {
        char line[160];
        std::snprintf(line, sizeof line, "%lld,%d,%d,%d,%lld,%.6f,%.3f,%d,%d\n", packet, r.block,
                      r.channel, r.laser, static_cast<long long>(epoch_ns) + r.time_ns,
                      std::fmod(r.azimuth_deg, 360.0), r.range_m, r.reflectivity, r.surface);
        text += line;
      }
    }
    file_->write(text);
  }
  void close() {
    if (file_) {
      file_->close();
    }
  }

 private:
  std::unique_ptr<OutputFile> file_;
};

struct Chunk {
  std::int64_t first = 0;
  std::vector<DataPacket> packets;
  std::vector<std::vector<Return>> returns;
};

// Shows the progress in one line that is rewritten; without a terminal, only the end is printed.
class Progress {
 public:
  Progress(const Options& options, double whole_s)
      : whole_s_(whole_s),
        live_(!options.quiet && isatty(STDERR_FILENO) != 0),
        quiet_(options.quiet) {}
  void show(double done_s) const {
    if (live_) {
      std::fprintf(stderr, "\rsimulated %.1f of %.1f s", done_s, whole_s_);
    }
  }
  void finish(std::int64_t packets) const {
    if (!quiet_) {
      std::fprintf(stderr, "%ssimulated %.1f s, %lld data packets\n", live_ ? "\r" : "", whole_s_,
                   static_cast<long long>(packets));
    }
  }

 private:
  double whole_s_;
  bool live_;
  bool quiet_;
};

Chunk simulate(const Sensor& sensor, std::int64_t first, std::int64_t count, int threads,
               bool with_returns) {
  Chunk chunk{first, {}, {}};
  const std::int64_t size = std::min(kChunkPackets, count - first);
  if (size > 0) {
    chunk.packets =
        data_packets(sensor, first, size, threads, with_returns ? &chunk.returns : nullptr);
  }
  return chunk;
}

// The next chunk is computed while this one is written or sent, so that live sending keeps pace.
void write_packets(const Options& options, const Sensor& sensor, double duration_s) {
  std::vector<std::unique_ptr<Sink>> sinks = make_sinks(options, sensor);
  ReturnsFile returns(options.returns);
  if (sinks.empty() && !returns.wanted()) {
    return;
  }
  FaultInjector faults(options.faults, options.simulation.epoch_ns);
  const std::int64_t count = sensor.packet_count(duration_s);
  const Progress progress(options, duration_s);
  const auto start = [&](std::int64_t first) {
    return std::async(std::launch::async, simulate, std::cref(sensor), first, count,
                      options.threads, returns.wanted());
  };
  std::future<Chunk> next = start(0);
  for (std::int64_t first = 0; first < count; first += kChunkPackets) {
    const Chunk chunk = next.get();
    next = start(first + kChunkPackets);
    const std::vector<Datagram> sent = faults.pass(datagrams(sensor, first, chunk.packets));
    for (const auto& sink : sinks) {
      sink->put(sent);
    }
    if (returns.wanted()) {
      returns.write(first, chunk.returns, options.simulation.epoch_ns);
    }
    progress.show(static_cast<double>(first * sensor.packet_period_ns()) * 1e-9);
  }
  const std::vector<Datagram> rest = faults.flush();
  for (const auto& sink : sinks) {
    sink->put(rest);
    sink->close();
  }
  returns.close();
  write_faults(options.fault_log, faults.log());
  progress.finish(count);
}

// A trajectory that stays at the first pose for the duration of the scene's motion.
Trajectory at_rest(const Scene& scene) {
  const Pose pose = scene.trajectory.at(0.0).T_world_body;
  const Eigen::Vector3d forward = pose.linear().col(0);
  Knot knot = Knot::Zero();
  knot.head<3>() = pose.translation();
  knot[3] = std::atan2(forward.y(), forward.x());
  return {{knot, knot}, scene.trajectory.duration_s()};
}

void run(const Options& options) {
  auto scene = options.world.ends_with(".yaml") ? read_scene(options.world, options.scene)
                                                : make_scene(options.world, options.scene);
  if (options.still) scene = std::make_shared<const Scene>(Scene{scene->world, at_rest(*scene)});
  const Sensor sensor(scene, options.simulation);
  // After the end of the motion the platform stands still.
  const double duration_s = options.duration_s > 0.0 ? options.duration_s : sensor.duration_s();
  write_trajectory(options.truth, sensor, duration_s, false);
  write_trajectory(options.truth_base, sensor, duration_s, true);
  write_sweep_truth(options.truth_sweeps, sensor, duration_s);
  write_imu(options, sensor, duration_s);
  if (options.scans) {
    write_scanner_files(Scanner(scene, options.simulation, options.scanner),
                        options.simulation.epoch_ns, duration_s, options.threads,
                        !options.quiet && isatty(STDERR_FILENO) != 0, options.scanner_files);
  } else {
    write_packets(options, sensor, duration_s);
  }
}

}  // namespace
}  // namespace zloam::simulator

int main(int argc, char** argv) {
  using namespace zloam::simulator;
  Options options;
  if (const auto code = parse_options(argc, argv, options)) {
    return *code;
  }
  try {
    run(options);
  } catch (const std::invalid_argument& error) {
    std::cerr << "zloam-simulator: " << error.what() << "\n";
    return kUsageError;
  } catch (const std::runtime_error& error) {
    std::cerr << "zloam-simulator: " << error.what() << "\n";
    return kIoError;
  } catch (const std::exception& error) {
    std::cerr << "zloam-simulator: " << error.what() << "\n";
    return kFailure;
  }
  return 0;
}
