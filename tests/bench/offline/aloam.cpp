// zloam-aloam-offline INPUT OUT [--deskew] [--model NAME] [--first N] [--count N]
//
// --model: VLP-16 (default) or HDL-64E; a folder in KITTI's layout does not tell, so it is needed.
//
// Runs A-LOAM's stages over a capture or a folder of scans (scan_reader.hpp), in one process and
// without messages. Writes the lidar's poses by odometry (odom.tum) and by mapping (est.tum),
// stamped with the instant for which they are valid. Prints the CPU time of each stage per sweep.

#include <cstdio>
#include <filesystem>
#include <stdexcept>
#include <string>
#include <vector>

#include "aloam/core/scan_registration.hpp"
#include "aloam/core/scan_to_map.hpp"
#include "aloam/core/scan_to_scan.hpp"
#include "aloam/core/sensor_defaults.hpp"
#include "run_files.hpp"
#include "scan_reader.hpp"

namespace zloam::offline {
namespace {

struct Options {
  std::string input, out;
  std::string model;
  bool deskew = false;
  std::size_t first = 0;
  std::size_t count = SIZE_MAX;
};

/// The model, whose defaults A-LOAM's launch files have.
std::string model_of(const std::string& asked, const std::filesystem::path& input) {
  if (asked.starts_with("HDL-64E") || asked == "VLP-16") return asked;
  if (!asked.empty()) throw std::invalid_argument("--model: VLP-16 or HDL-64E, not " + asked);
  if (std::filesystem::is_directory(input) && !std::filesystem::exists(input / "stamps.txt")) {
    throw std::invalid_argument("--model is needed for " + input.string() + ": VLP-16 or HDL-64E");
  }
  return "VLP-16";
}

Options parse_options(const std::vector<std::string>& args) {
  Options o;
  std::vector<std::string> positional;
  for (std::size_t i = 0; i < args.size(); ++i) {
    if (args[i] == "--deskew") {
      o.deskew = true;
    } else if (args[i] == "--model") {
      o.model = args.at(++i);
    } else if (args[i] == "--first") {
      o.first = std::stoul(args.at(++i));
    } else if (args[i] == "--count") {
      o.count = std::stoul(args.at(++i));
    } else {
      add_positional(positional, args[i]);
    }
  }
  if (positional.size() != 2) {
    throw std::invalid_argument("usage: zloam-aloam-offline INPUT OUT [--deskew] [--model NAME]");
  }
  o.input = positional[0];
  o.out = positional[1];
  o.model = model_of(o.model, o.input);
  return o;
}

class Run {
 public:
  explicit Run(const Options& options)
      : defaults_(aloam::defaults_of(options.model)),
        odometry_(options.deskew),
        mapping_(defaults_.leaves) {
    std::filesystem::create_directories(options.out);
    odom_file_.create(options.out + "/odom.tum");
    est_file_.create(options.out + "/est.tum");
  }

  void sweep(const Scan& scan) {
    const double t0 = cpu_ms();
    const aloam::ScanFeatures f =
        aloam::extract_features(scan.points, defaults_.min_range_m, defaults_.elevations);
    const double t1 = cpu_ms();
    const aloam::ScanView view{scan.stamp_ns, scan.period_ns, scan.deskewed, f.sharp,
                               f.less_sharp,  f.flat,         f.less_flat};
    const aloam::ScanMotion motion = odometry_.process(view);
    const double t2 = cpu_ms();
    const aloam::Mapped mapped = mapping_.process(motion.edges, motion.planes, motion.T_odom_lidar);
    const double t3 = cpu_ms();
    const std::int64_t instant_ns = scan.stamp_ns + aloam::ScanToScan::instant_ns(view);
    write_tum(odom_file_, instant_ns, motion.T_odom_lidar);
    write_tum(est_file_, instant_ns, mapped.T_map_base);
    registration_ms_ += t1 - t0;
    odometry_ms_ += t2 - t1;
    mapping_ms_ += t3 - t2;
    ++sweeps_;
  }

  void finish() {
    odom_file_.finish();
    est_file_.finish();
  }

  void summary() const {
    const double n = sweeps_ == 0 ? 1.0 : static_cast<double>(sweeps_);
    std::printf(
        "sweeps %zu, CPU ms/sweep: registration %.2f odometry %.2f mapping %.2f, map %zu points\n",
        sweeps_, registration_ms_ / n, odometry_ms_ / n, mapping_ms_ / n,
        mapping_.map().point_count());
  }

 private:
  aloam::SensorDefaults defaults_;
  aloam::ScanToScan odometry_;
  aloam::ScanToMap mapping_;
  ResultFile odom_file_, est_file_;
  double registration_ms_ = 0.0;
  double odometry_ms_ = 0.0;
  double mapping_ms_ = 0.0;
  std::size_t sweeps_ = 0;
};

int run(const std::vector<std::string>& args) {
  const Options options = parse_options(args);
  ScanReader reader(options.input, {});
  Run run(options);
  Scan scan;
  for (std::size_t i = 0; reader.next(scan); ++i) {
    if (i < options.first) continue;
    if (i - options.first >= options.count) break;
    run.sweep(scan);
  }
  run.finish();
  run.summary();
  return 0;
}

}  // namespace
}  // namespace zloam::offline

int main(int argc, char** argv) {
  return zloam::offline::run_main("zloam-aloam-offline", argc, argv, zloam::offline::run);
}
