// Decodes a capture without the stages, to write points as binary for comparisons or to measure the
// speed. KITTI scans get times of a clockwise revolution of 0.1 s with its seam at the rear.

#include <malloc.h>

#include <CLI/CLI.hpp>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <fstream>
#include <iostream>
#include <iterator>
#include <optional>
#include <sstream>
#include <string>

#include "common/geometry/output_file.hpp"
#include "driver/io/metadata_file.hpp"
#include "driver/io/scip_source.hpp"
#include "driver/io/sweep_source.hpp"

namespace {

using namespace zloam::driver;

struct Options {
  std::string path;
  std::string out;
  std::string imu_out;
  std::string kind = "--pcap";
  int repeat = 1;
  bool in_memory = false;
  std::string metadata;
  DecodingOptions decoding;
  AssemblerConfig assembler;
};

struct Record {
  float x, y, z, intensity;
  std::int64_t time_ns;
  std::uint16_t ring;
  std::uint8_t return_type;
  std::uint8_t zero;
  std::uint16_t column;
  std::uint16_t sweep;
};
static_assert(sizeof(Record) == 32);

const char* const kFooter =
    "The summary is one JSON line. POINTS: 32-byte little-endian records {float x, y, z, "
    "intensity; int64 time_ns; uint16 ring; uint8 return type; uint8 0; uint16 column; "
    "uint16 sweep}.\n"
    "Exit codes: 0 done; 2 wrong command line; 3 a file can't be read or written.";

/// Ends the process if the command line is wrong or only asks for help or version.
Options parse(int argc, char** argv) {
  Options options;
  CLI::App app("decodes a capture without the stages, to compare points or to measure the speed",
               "zloam-decode");
  app.footer(kFooter);
  auto* source = app.add_option_group("source")->require_option(1);
  const auto add_source = [&](const char* kind, const char* what) {
    const auto take = [&options, kind](const std::string& path) {
      options.path = path;
      options.kind = kind;
    };
    source->add_option_function<std::string>(kind, take, what);
  };
  add_source("--pcap", "a capture");
  add_source("--bin", "payloads of data packets, one after the other");
  add_source("--kitti", "a folder of scans in KITTI's layout");
  add_source("--scans", "a folder of scans with times");
  add_source(
      "--session",
      "replies of a Hokuyo scanner; its points are rotated by the angles in the .csv beside it");
  const auto take_model = [&options](const std::string& name) {
    options.decoding.model = name;
    if (is_known_model(name)) return;
    std::string known;
    for (const std::string& model : known_models()) known += (known.empty() ? "" : ", ") + model;
    throw CLI::ValidationError("--model", name + " is none of " + known);
  };
  app.add_option_function<std::string>("--model", take_model,
                                       "model of the sensor; default: from the packets");
  app.add_option(
      "--metadata", options.metadata,
      "file with the sensor's description of itself; default: the .json beside a capture; of a "
      "session: its mount file");
  app.add_option("--seam", options.assembler.seam_azimuth_deg, "azimuth of the cut, degrees");
  app.add_flag("!--no-offsets", options.decoding.vertical_offsets,
               "ignore the lasers' vertical offsets");
  app.add_option("--out", options.out, "file for the points (POINTS, below)");
  app.add_option("--imu-out", options.imu_out, "file for the readings of the sensor's own IMU");
  app.add_option("--repeat", options.repeat, "number of repetitions")->check(CLI::PositiveNumber);
  app.add_flag("--in-memory", options.in_memory,
               "read the payloads (--bin) before the clock starts, so that cpu_seconds covers only "
               "decoding and cutting");
  app.set_version_flag("--version", "zloam-decode " ZLOAM_VERSION);
  try {
    app.parse(argc, argv);
    if (options.in_memory && options.kind != "--bin") {
      throw CLI::ValidationError("--in-memory", "is for --bin");
    }
  } catch (const CLI::ParseError& error) {
    std::exit(app.exit(error) == 0 ? 0 : 2);
  }
  options.assembler.clock_mode =
      options.kind == "--bin" ? ClockMode::kFreeRunning : ClockMode::kReceive;
  return options;
}

void write_points(zloam::OutputFile& out, const DecodedSweep& sweep, std::uint16_t number) {
  std::vector<Record> records;
  records.reserve(sweep.points.size());
  for (std::size_t i = 0; i < sweep.points.size(); ++i) {
    const zloam::Point& p = sweep.points[i];
    records.push_back({p.x, p.y, p.z, p.intensity, sweep.stamp_ns + p.time_ns, p.ring,
                       static_cast<std::uint8_t>(p.return_type), 0, sweep.columns[i], number});
  }
  out.write(records.data(), records.size() * sizeof(Record));
}

/// In the format that driver.imu_path reads.
void write_readings(zloam::OutputFile& out, const std::vector<zloam::ImuReading>& readings) {
  std::ostringstream lines;
  lines.precision(9);
  for (const zloam::ImuReading& r : readings) {
    lines << r.stamp_ns;
    for (const double value : {r.rate_radps.x(), r.rate_radps.y(), r.rate_radps.z(),
                               r.force_mps2.x(), r.force_mps2.y(), r.force_mps2.z()}) {
      lines << ',' << value;
    }
    lines << '\n';
  }
  out.write(lines.str());
}

/// Concatenated payloads in memory.
class MemorySource : public PacketSource {
 public:
  MemorySource(std::span<const std::uint8_t> payloads, std::size_t payload_bytes)
      : left_(payloads), payload_bytes_(payload_bytes) {}
  Read next(Datagram& datagram, int /*timeout_ms*/) override {
    if (left_.size() < payload_bytes_) return Read::kEnd;
    datagram = {};
    datagram.payload = left_.first(payload_bytes_);
    left_ = left_.subspan(payload_bytes_);
    return Read::kDatagram;
  }
  NamedCounts counts() const override { return {}; }

 private:
  std::span<const std::uint8_t> left_;
  std::size_t payload_bytes_;
};

std::vector<std::uint8_t> read_file(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file) throw SourceError(path + ": " + std::strerror(errno));
  return {std::istreambuf_iterator<char>(file), {}};
}

double cpu_seconds() {
  std::timespec now{};
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
  return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}

struct Totals {
  std::uint64_t points = 0;
  std::uint64_t sweeps = 0;
  std::uint64_t complete = 0;
  double seconds = 0.0;
  double cpu_seconds = 0.0;
  NamedCounts counts;
  std::vector<std::string> remarks;
};

std::unique_ptr<SweepSource> open_source(const Options& options,
                                         std::span<const std::uint8_t> in_memory) {
  if (options.kind == "--kitti") {
    return sweeps_of_scans(open_kitti(options.path, {TimeModel::kClockwise, 0.1, 180.0}));
  }
  if (options.kind == "--scans") return sweeps_of_scans(open_synth(options.path));
  if (options.kind == "--session") {
    return sweeps_of_session(options.path, read_mount_file(options.metadata));
  }
  PacketStreamConfig stream;
  stream.decoding = options.decoding;
  stream.assembler = options.assembler;
  const bool bare = options.kind == "--bin";
  read_metadata(options.metadata, bare ? "" : options.path, stream.decoding);
  const std::size_t payload_bytes = Makers(stream.decoding).maker().payload_bytes();
  std::unique_ptr<PacketSource> packets;
  // The file's source refuses an unknown length.
  if (options.in_memory && payload_bytes > 0) {
    packets = std::make_unique<MemorySource>(in_memory, payload_bytes);
  } else {
    packets = bare ? open_payload_file(options.path, payload_bytes) : open_pcap(options.path);
  }
  return sweeps_of_packets(std::move(packets), stream, 0);
}

struct Outputs {
  std::optional<zloam::OutputFile> points, readings;
};

void run_once(const Options& options, std::span<const std::uint8_t> in_memory, Outputs& out,
              Totals& totals) {
  const auto begin = std::chrono::steady_clock::now();
  const double cpu_begin_s = cpu_seconds();
  const auto source = open_source(options, in_memory);
  DecodedSweep sweep;
  while (source->pull(sweep) == Pull::kSweep) {
    if (out.points) {
      write_points(*out.points, sweep, static_cast<std::uint16_t>(totals.sweeps));
    }
    if (out.readings) write_readings(*out.readings, source->take_imu());
    totals.points += sweep.points.size();
    totals.complete += sweep.complete;
    ++totals.sweeps;
  }
  // Those after the last sweep.
  if (out.readings) write_readings(*out.readings, source->take_imu());
  totals.seconds += std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
  totals.cpu_seconds += cpu_seconds() - cpu_begin_s;
  totals.counts = source->counts();
  totals.remarks = source->remarks();
}

/// Throws SourceError.
void print(const Totals& totals) {
  std::cout << "{\"points\":" << totals.points << ",\"sweeps\":" << totals.sweeps
            << ",\"complete\":" << totals.complete << ",\"seconds\":" << totals.seconds
            << ",\"cpu_seconds\":" << totals.cpu_seconds
            << ",\"points_per_second\":" << static_cast<double>(totals.points) / totals.seconds;
  for (const auto& [name, count] : totals.counts) {
    if (name != "points") std::cout << ",\"" << name << "\":" << count;
  }
  std::cout << "}\n" << std::flush;
  if (!std::cout) throw SourceError("standard output: the summary can't be written");
  for (const std::string& text : totals.remarks) std::cerr << "zloam-decode: " << text << "\n";
}

}  // namespace

int main(int argc, char** argv) {
  const Options options = parse(argc, argv);
  // Freed memory stays with the process, as in a driver that runs on, so that repetitions do not
  // pay for page faults again.
  mallopt(M_MMAP_THRESHOLD, 1 << 30);
  mallopt(M_TRIM_THRESHOLD, 1 << 30);
  try {
    Outputs out;
    if (!options.out.empty()) out.points.emplace(options.out);
    if (!options.imu_out.empty()) {
      out.readings.emplace(options.imu_out);
      out.readings->write("t_ns,wx_rad_s,wy_rad_s,wz_rad_s,ax_m_s2,ay_m_s2,az_m_s2\n");
    }
    Totals totals;
    std::vector<std::uint8_t> in_memory;
    if (options.in_memory) in_memory = read_file(options.path);
    for (int i = 0; i < options.repeat; ++i) run_once(options, in_memory, out, totals);
    if (out.points) out.points->close();
    if (out.readings) out.readings->close();
    print(totals);
  } catch (const std::exception& error) {
    std::cerr << "zloam-decode: " << error.what() << "\n";
    return 3;
  }
  return 0;
}
