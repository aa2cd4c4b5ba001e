// Runs the registration over recorded scans and writes the trajectory, for experiments.
//
//   plane_map_offline DIR PREFIX [key=value ...]
//
// DIR holds scans/%06d.bin (x y z float32, intensity and ring uint8, time uint16 in 2 us) and
// stamps.txt (begin and end in s); or velodyne/%06d.bin (x y z reflectance float32) of a clockwise
// sweep of 0.1 s with its seam at the rear. Writes PREFIX_mid.tum and
// PREFIX_end.tum, poses stamped with the instant they hold for. Prints CPU time, memory and voxels.

#include <sys/resource.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <fstream>
#include <functional>
#include <iostream>
#include <iterator>
#include <map>
#include <numbers>
#include <string>
#include <vector>

#include "common/plane_map/plane_registration.hpp"

namespace {

using namespace zloam;
using namespace zloam::plane_map;

struct SynthRecord {
  float x, y, z;
  std::uint8_t intensity, ring;
  std::uint16_t time_2us;
};
static_assert(sizeof(SynthRecord) == 16);

struct KittiRecord {
  float x, y, z, reflectance;
};

template <typename T>
std::vector<T> read_records(const std::string& path) {
  std::ifstream in(path, std::ios::binary | std::ios::ate);
  if (!in) {
    return {};
  }
  std::vector<T> records(static_cast<std::size_t>(in.tellg()) / sizeof(T));
  in.seekg(0);
  in.read(reinterpret_cast<char*>(records.data()),
          static_cast<std::streamsize>(records.size() * sizeof(T)));
  return records;
}

std::string numbered(const std::string& folder, int k) {
  char name[32];
  std::snprintf(name, sizeof name, "/%06d.bin", k);
  return folder + name;
}

PointVector read_synth(const std::string& path) {
  PointVector points;
  for (const SynthRecord& r : read_records<SynthRecord>(path)) {
    points.push_back({r.x, r.y, r.z, static_cast<float>(r.intensity), r.time_2us * 2000u, r.ring,
                      ReturnType::kStrongest, 0});
  }
  return points;
}

PointVector read_kitti(const std::string& path) {
  PointVector points;
  for (const KittiRecord& r : read_records<KittiRecord>(path)) {
    const double turn = 0.5 - std::atan2(r.y, r.x) / (2.0 * std::numbers::pi);
    const double time_ns = std::clamp(turn, 0.0, 1.0) * 1e8;
    points.push_back({r.x, r.y, r.z, r.reflectance, static_cast<std::uint32_t>(time_ns), 0,
                      ReturnType::kStrongest, 0});
  }
  std::stable_sort(points.begin(), points.end(),
                   [](const Point& a, const Point& b) { return a.time_ns < b.time_ns; });
  return points;
}

std::vector<double> read_stamps(const std::string& folder) {
  std::vector<double> stamps;
  std::ifstream in(folder + "/stamps.txt");
  for (double begin = 0, end = 0; in >> begin >> end;) {
    stamps.push_back(begin);
  }
  return stamps;
}

double cpu_ms() {
  timespec t{};
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
  return static_cast<double>(t.tv_sec) * 1e3 + static_cast<double>(t.tv_nsec) * 1e-6;
}

struct Options {
  PlaneMapConfig map;
  MatcherConfig matcher;
  int scans = 1 << 30;
  bool trace = false;
};

using Setter = std::function<void(Options&, double)>;

const std::map<std::string, Setter>& setters() {
  static const std::map<std::string, Setter> all = {
      {"n", [](Options& o, double v) { o.scans = static_cast<int>(v); }},
      {"trace", [](Options& o, double v) { o.trace = v != 0; }},
      {"levels", [](Options& o, double v) { o.map.levels = static_cast<int>(v); }},
      {"root", [](Options& o, double v) { o.map.root_voxel_m = v; }},
      {"noise", [](Options& o, double v) { o.map.range_noise_m = v; }},
      {"growth", [](Options& o, double v) { o.map.refit_growth = v; }},
      {"settled", [](Options& o, double v) { o.map.settled_points = static_cast<unsigned>(v); }},
      {"dist", [](Options& o, double v) { o.map.distributions = v != 0; }},
      {"merge", [](Options& o, double v) { o.map.merge_radius_voxels = v; }},
      {"keep", [](Options& o, double v) { o.map.keep_radius_m = v; }},
      {"mthick", [](Options& o, double v) { o.map.merged_thickness_sigmas = v; }},
      {"thick", [](Options& o, double v) { o.map.thickness_sigmas = v; }},
      {"rot", [](Options& o, double v) { o.map.grid_rotation_rad *= v; }},
      {"stride", [](Options& o, double v) { o.matcher.stride = static_cast<unsigned>(v); }},
      {"enough",
       [](Options& o, double v) { o.matcher.enough_points = static_cast<std::size_t>(v); }},
      {"it", [](Options& o, double v) { o.matcher.max_iterations = static_cast<int>(v); }},
      {"gate", [](Options& o, double v) { o.matcher.min_gate_m = v; }},
      {"stop",
       [](Options& o, double v) {
         o.matcher.stop_rotation_rad *= v;
         o.matcher.stop_translation_m *= v;
       }},
      {"pt", [](Options& o, double v) { o.matcher.pose_sigma_m = v; }},
      {"pr", [](Options& o, double v) { o.matcher.pose_sigma_rad = v; }},
      {"bt", [](Options& o, double v) { o.matcher.continuity_sigma_m = v; }},
      {"bs", [](Options& o, double v) { o.matcher.continuity_share = v; }},
      {"br", [](Options& o, double v) { o.matcher.continuity_sigma_rad = v; }},
      {"vt", [](Options& o, double v) { o.matcher.change_sigma_m = v; }},
      {"vr", [](Options& o, double v) { o.matcher.change_sigma_rad = v; }},
      {"corr", [](Options& o, double v) { o.matcher.correlation = v; }},
      {"crowd", [](Options& o, double v) { o.matcher.crowd_points = v; }},
  };
  return all;
}

Options parse(int argc, char** argv) {
  Options options;
  for (int i = 3; i < argc; ++i) {
    const std::string arg = argv[i];
    const std::size_t equals = arg.find('=');
    const auto found = setters().find(arg.substr(0, equals));
    if (equals == std::string::npos || found == setters().end()) {
      std::cerr << "unknown option " << arg << "\n";
      std::exit(2);
    }
    found->second(options, std::atof(arg.c_str() + equals + 1));
  }
  return options;
}

void write_pose(std::FILE* out, double time_s, const Pose& pose) {
  const Eigen::Quaterniond q(pose.linear());
  const Eigen::Vector3d t = pose.translation();
  std::fprintf(out, "%.6f %.9f %.9f %.9f %.9f %.9f %.9f %.9f\n", time_s, t.x(), t.y(), t.z(), q.x(),
               q.y(), q.z(), q.w());
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 3) {
    std::cerr << "usage: plane_map_offline DIR PREFIX [key=value ...]\n";
    return 2;
  }
  const Options options = parse(argc, argv);
  const std::string folder = argv[1];
  const std::vector<double> stamps = read_stamps(folder);
  const std::string prefix = argv[2];
  std::FILE* out_mid = std::fopen((prefix + "_mid.tum").c_str(), "w");
  std::FILE* out_end = std::fopen((prefix + "_end.tum").c_str(), "w");
  if (out_mid == nullptr || out_end == nullptr) {
    std::cerr << "cannot write " << prefix << "_*.tum\n";
    return 1;
  }
  constexpr double kPeriod_s = 0.1;
  PlaneRegistration registration(options.map, options.matcher);
  std::vector<double> times;
  double iterations = 0;
  double matched = 0;
  std::size_t weak = 0;
  for (int k = 0; k < options.scans; ++k) {
    const bool synth = !stamps.empty();
    const PointVector points = synth ? read_synth(numbered(folder + "/scans", k))
                                     : read_kitti(numbered(folder + "/velodyne", k));
    if (points.empty()) {
      break;
    }
    const double stamp_s = synth ? stamps[static_cast<std::size_t>(k)] : k * kPeriod_s;
    SweepInput sweep;
    sweep.points = points;
    sweep.stamp_ns = std::llround(stamp_s * 1e9);
    const double begin = cpu_ms();
    const RegistrationResult r = registration.process(sweep);
    times.push_back(cpu_ms() - begin);
    iterations += r.iterations;
    matched += r.matched_fraction;
    weak += r.degeneracy.weak ? 1 : 0;
    write_pose(out_mid, stamp_s + 0.5 * kPeriod_s, r.T_map_base_mid);
    write_pose(out_end, stamp_s + kPeriod_s, r.T_map_base_end);
    if (options.trace) {
      const Vector6& v = r.twist_per_s;
      std::printf("twist %.7f %.7f %.7f %.7f %.7f %.7f\n", v[0], v[1], v[2], v[3], v[4], v[5]);
      const Degeneracy& d = r.degeneracy;
      std::printf(
          "%d ms %.1f it %d matched %.2f rms %.4f gate %.2f sigma %.4f / %.4f share %.4f weak %d "
          "axis %.2f %.2f %.2f\n",
          k, times.back(), r.iterations, r.matched_fraction, r.residual_rms_m, r.gate_m,
          d.measured_sigma_m, d.predicted_sigma_m, d.share, d.weak, d.axis.x(), d.axis.y(),
          d.axis.z());
    }
  }
  std::fclose(out_mid);
  std::fclose(out_end);
  const double n = std::max<double>(1.0, static_cast<double>(times.size()));
  double sum = 0;
  for (const double t : times) {
    sum += t;
  }
  std::sort(times.begin(), times.end());
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  const MapStatistics map = registration.map().statistics();
  std::printf(
      "sweeps %zu ms %.2f p95 %.2f it %.2f matched %.3f weak %zu roots %zu voxels %zu map_MB %.1f "
      "rss_MB %.1f\n",
      times.size(), sum / n, times.empty() ? 0.0 : times[times.size() * 95 / 100], iterations / n,
      matched / n, weak, map.roots, map.voxels, map.bytes / 1e6, usage.ru_maxrss / 1e3);
  return 0;
}
