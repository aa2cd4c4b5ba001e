#include "simulator/io/scanner_files.hpp"

#include <array>
#include <cmath>
#include <cstdio>
#include <future>
#include <vector>

#include "simulator/io/sinks.hpp"
#include "simulator/random.hpp"

namespace zloam::simulator {
namespace {

constexpr std::int64_t kLinesPerChunk = 40;

/// Computes the lines [first, first + count) with several threads.
std::vector<ScanLine> lines_of(const Scanner& scanner, std::int64_t first, std::int64_t count,
                               int threads) {
  std::vector<ScanLine> lines(static_cast<std::size_t>(count));
  std::vector<std::future<void>> workers;
  workers.reserve(static_cast<std::size_t>(threads));
  for (int worker = 0; worker < threads; ++worker) {
    workers.push_back(std::async(std::launch::async, [&, worker] {
      for (std::int64_t i = worker; i < count; i += threads) {
        lines[static_cast<std::size_t>(i)] = scanner.line(first + i);
      }
    }));
  }
  for (auto& worker : workers) worker.get();
  return lines;
}

void write_record(OutputFile& file, std::int64_t unix_ns, const std::string& bytes) {
  std::array<std::uint8_t, 12> head{};
  const auto put = [&](std::size_t at, std::int64_t value) {
    for (std::size_t i = 0; i < 4; ++i) {
      head[at + i] = static_cast<std::uint8_t>(value >> (24 - 8 * i));
    }
  };
  put(0, unix_ns / 1'000'000'000);
  put(4, unix_ns % 1'000'000'000 / 1'000);
  put(8, static_cast<std::int64_t>(bytes.size()));
  file.write(head.data(), head.size());
  file.write(bytes);
}

std::string command_of(const Scanner& scanner, bool intensities) {
  std::array<char, 32> text{};
  std::snprintf(text.data(), text.size(), "M%c%04d%04d01000", intensities ? 'E' : 'D',
                scanner.config().first_step, scanner.config().last_step);
  return text.data();
}

void write_session(const Scanner& scanner, std::int64_t epoch_ns, double duration_s, int threads,
                   bool progress, const ScannerFiles& files) {
  OutputFile file(files.session);
  const scip::Scanner& device = scanner.config().scanner;
  const std::string command = command_of(scanner, files.intensities);
  write_record(file, epoch_ns, scip::reply("PP", "00", scip::parameters(device)));
  write_record(file, epoch_ns, scip::reply(command, "00"));
  const std::int64_t count = scanner.line_count(duration_s);
  for (std::int64_t first = 0; first < count; first += kLinesPerChunk) {
    const std::int64_t size = std::min(kLinesPerChunk, count - first);
    for (const ScanLine& line : lines_of(scanner, first, size, threads)) {
      const std::int64_t received_ns =
          line.time_ns + device.step_ns(scanner.config().last_step) + kLineDelayNs +
          static_cast<std::int64_t>(mixed(static_cast<std::uint64_t>(line.time_ns)) %
                                    static_cast<std::uint64_t>(kLineJitterNs));
      write_record(file, epoch_ns + received_ns,
                   scip::reply(command, "99",
                               scip::scan_lines(line.counter_ms, line.echoes, files.intensities)));
    }
    if (progress) {
      std::fprintf(stderr, "\rsimulated %.1f of %.1f s",
                   1e-9 * static_cast<double>((first + size) * device.turn_ns()), duration_s);
    }
  }
  if (progress) std::fprintf(stderr, "\n");
  file.close();
}

void write_angles(const Scanner& scanner, std::int64_t epoch_ns, double duration_s,
                  const std::string& path) {
  OutputFile file(path);
  file.write("t_ns,angle_rad\n");
  // The readings extend beyond the last line.
  constexpr double kAfter_s = 0.1;
  const auto count = static_cast<std::int64_t>(
      std::ceil((duration_s + kAfter_s) * scanner.config().motor.encoder_hz));
  for (const AngleReading& reading : scanner.motor().readings(0, count)) {
    std::array<char, 32> angle{};
    std::snprintf(angle.data(), angle.size(), ",%.9f\n", reading.angle_rad);
    file.write(std::to_string(epoch_ns + reading.time_ns) + angle.data());
  }
  file.close();
}

}  // namespace

void write_scanner_files(const Scanner& scanner, std::int64_t epoch_ns, double duration_s,
                         int threads, bool progress, const ScannerFiles& files) {
  if (!files.angles.empty()) write_angles(scanner, epoch_ns, duration_s, files.angles);
  if (!files.session.empty()) {
    write_session(scanner, epoch_ns, duration_s, threads, progress, files);
  }
}

}  // namespace zloam::simulator
