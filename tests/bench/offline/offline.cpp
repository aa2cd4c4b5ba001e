// zloam-offline INPUT OUT [--list] [--set key=value]... [--first N] [--count N]
//   [--mount x y z roll pitch yaw] [--imu FILE] [--imu-mount x y z roll pitch yaw]
//   [--no-mapping] [--map-gaps EVERY SWEEPS] [--thin N] [--submaps FILE]
//   [--seam DEG] [--counter-clockwise] [--deskewed] [--sweep S] [--stamp-offset-us US]
//   [--elevation-offset DEG] [--range-offset M]
//
// Runs registration, odometry, mapping and integration over a capture, a folder of scans or a
// simulated drive (scan_reader.hpp), in one process and without messages. Writes poses of
// base_link, stamped with the instant for which they are valid: odom.tum, est.tum (mapping) and
// fused.tum (integration, as in a replay); sweeps.csv; fused.csv (health, degenerate direction and
// jump of each fused pose); covariance.csv and fused_covariance.csv (sweep, then the pose's 6x6 row
// by row); cost.csv (points and CPU time of each sweep, points in the map). Prints the CPU time of
// each stage per sweep.
//
// --map-gaps withholds the last SWEEPS of every EVERY sweeps from mapping; --thin keeps the returns
// of every N-th firing. --seam and --counter-clockwise are for scans in KITTI's layout, --deskewed
// (all points are valid at the end of the sweep) for any folder, --sweep and --stamp-offset-us for
// a scanner's session.

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <stdexcept>
#include <string>
#include <vector>

#include "common/geometry/se3.hpp"
#include "driver/imu/imu_buffer.hpp"
#include "driver/io/imu_file.hpp"
#include "integration/integration.hpp"
#include "mapping/mapping.hpp"
#include "odometry/odometry.hpp"
#include "registration/registration.hpp"
#include "run_files.hpp"
#include "scan_reader.hpp"
#include "settings.hpp"
#include "submap_file.hpp"

namespace zloam::offline {
namespace {

struct Options {
  std::string input, out;
  std::size_t first = 0;
  std::size_t count = SIZE_MAX;
  Pose T_base_lidar = Pose::Identity();
  Pose T_base_imu = Pose::Identity();
  std::vector<ImuReading> imu;
  std::string submaps;
  bool with_mapping = true;
  // the last gap_sweeps of every gap_every sweeps do not reach mapping, as if it were down
  std::uint64_t gap_every = 0, gap_sweeps = 0;
  std::uint64_t thin = 1;
  Settings settings;
  ReadOptions reading;
};

// Parses an option about reading the input; false if `name` is no such option.
template <typename Value>
bool parse_reading(const std::string& name, const Value& value, ReadOptions& reading) {
  if (name == "--seam") {
    reading.timing.seam_deg = std::stod(value());
  } else if (name == "--counter-clockwise") {
    reading.timing.model = driver::TimeModel::kCounterClockwise;
  } else if (name == "--deskewed") {
    reading.timing.model = driver::TimeModel::kDeskewed;
  } else if (name == "--elevation-offset") {
    reading.elevation_offset_deg = std::stod(value());
  } else if (name == "--sweep") {
    reading.sweep_s = std::stod(value());
  } else if (name == "--stamp-offset-us") {
    reading.stamp_offset_us = std::stod(value());
  } else if (name == "--range-offset") {
    reading.range_offset_m = std::stod(value());
  } else {
    return false;
  }
  return true;
}

Options parse_options(const std::vector<std::string>& args) {
  Options o;
  std::vector<std::string> positional;
  for (std::size_t i = 0; i < args.size(); ++i) {
    const auto value = [&] { return args.at(++i); };
    if (args[i] == "--set") {
      assign_setting(value(), o.settings);
    } else if (args[i] == "--map-gaps") {
      o.gap_every = std::stoull(value());
      o.gap_sweeps = std::stoull(value());
    } else if (args[i] == "--thin") {
      o.thin = std::max<std::uint64_t>(1, std::stoull(value()));
    } else if (args[i] == "--first") {
      o.first = std::stoul(value());
    } else if (args[i] == "--count") {
      o.count = std::stoul(value());
    } else if (args[i] == "--no-mapping") {
      o.with_mapping = false;
    } else if (args[i] == "--list") {
      std::fputs(listing(o.settings).c_str(), stdout);
      std::exit(0);
    } else if (args[i] == "--mount" || args[i] == "--imu-mount") {
      double v[6];
      for (double& x : v) {
        x = std::stod(value());
      }
      Pose& mounting = args[i - 6] == "--mount" ? o.T_base_lidar : o.T_base_imu;
      mounting = pose_from_xyz_rpy_deg({v[0], v[1], v[2]}, {v[3], v[4], v[5]});
    } else if (args[i] == "--submaps") {
      o.submaps = value();
    } else if (args[i] == "--imu") {
      o.imu = driver::read_imu_file(value());
    } else if (!parse_reading(args[i], value, o.reading)) {
      add_positional(positional, args[i]);
    }
  }
  if (positional.size() != 2) {
    throw std::invalid_argument("usage: zloam-offline INPUT OUT [--set key=value]...");
  }
  if (o.gap_every > 0 && o.gap_sweeps >= o.gap_every) {
    throw std::invalid_argument("--map-gaps: SWEEPS must be below EVERY");
  }
  o.input = positional[0];
  o.out = positional[1];
  return o;
}

// Thins out the points as if the sensor fired less often by this factor.
void thin_out(Scan& scan, std::uint64_t factor) {
  if (factor <= 1 || scan.period_ns == 0) return;
  constexpr std::uint64_t kParts = 1800;  // firings per revolution of a VLP-16 at 10 Hz
  std::erase_if(scan.points, [&](const Point& p) {
    return std::uint64_t{p.time_ns} * kParts / scan.period_ns % factor != 0;
  });
}

class Run {
 public:
  explicit Run(const Options& options)
      : o_(options),
        odometry_(options.settings.odometry, options.T_base_lidar, options.T_base_imu),
        mapper_(options.settings.mapping),
        integrator_(options.settings.integration) {
    std::filesystem::create_directories(o_.out);
    for (const ImuReading& r : o_.imu) imu_.add(r);
    odom_file_.create(o_.out + "/odom.tum");
    est_file_.create(o_.out + "/est.tum");
    csv_.create(o_.out + "/sweeps.csv");
    csv_ << "sweep,health,iterations,planes,residual_m,prediction_error_m,"
            "prediction_error_rad,weak,weak_sigma,predicted_sigma,share,sharp,less_sharp,flat,"
            "less_flat,noise_m,map_health,map_residual_m,map_weak,map_weak_sigma,"
            "map_predicted_sigma,map_share,axis_x,axis_y,axis_z,inserted,odom_axis_x,odom_axis_y,"
            "odom_axis_z,map_iterations,imu_used,imu_contradictions\n";
    if (!o_.submaps.empty()) submaps_file_.create(o_.submaps, std::ios::binary);
    fused_file_.create(o_.out + "/fused.tum");
    covariance_file_.create(o_.out + "/covariance.csv");
    fused_csv_.create(o_.out + "/fused.csv");
    fused_csv_ << "sweep,health,degenerate,axis_x,axis_y,axis_z,jump,odometry_drifts\n";
    fused_covariance_file_.create(o_.out + "/fused_covariance.csv");
    cost_file_.create(o_.out + "/cost.csv");
    cost_file_ << "sweep,points,registration_ms,odometry_ms,mapping_ms,map_points\n";
  }

  void sweep(std::uint64_t number, const Scan& scan) {
    const double t0 = cpu_ms();
    const auto features = registration::extract_features(scan.points, {scan.period_ns, scan.rings},
                                                         o_.settings.registration);
    const double t1 = cpu_ms();
    odometry::FeatureSweep input;
    input.sweep = number;
    input.stamp_ns = scan.stamp_ns;
    input.period_ns = scan.period_ns;
    input.deskewed = scan.deskewed;
    input.range_noise_m = o_.settings.registration.range_noise_m;
    input.slices = scan.slices;
    input.less_sharp = features.less_sharp;
    input.less_flat = features.less_flat;
    const auto readings = imu_.covering(scan.stamp_ns, scan.stamp_ns + scan.period_ns);
    input.imu = readings;
    const auto odom = odometry_.process(input);
    const double t2 = cpu_ms();
    write_tum(odom_file_, odom.instant_ns, odom.T_odom_base);
    write_row(features, odom);
    map(scan, input, odom);
    const double t3 = cpu_ms();
    registration_ms_ += t1 - t0;
    odometry_ms_ += t2 - t1;
    mapping_ms_ += t3 - t2;
    cost_file_ << number << ',' << scan.points.size() << ',' << t1 - t0 << ',' << t2 - t1 << ','
               << t3 - t2 << ',' << map_points() << '\n';
    iterations_ += odom.diagnostics.iterations;
    points_ += scan.points.size();
    ++sweeps_;
  }

  void finish() {
    if (const auto submap = mapper_.finish_submap()) write_submap(submaps_file_, *submap);
    for (ResultFile* file : {&odom_file_, &est_file_, &fused_file_, &csv_, &covariance_file_,
                             &fused_csv_, &fused_covariance_file_, &cost_file_, &submaps_file_}) {
      file->finish();
    }
  }

  void summary() const {
    const double n = sweeps_ == 0 ? 1.0 : static_cast<double>(sweeps_);
    std::printf(
        "sweeps %zu, points/sweep %.0f, CPU ms/sweep: registration %.2f odometry %.2f mapping "
        "%.2f, odometry iterations %.1f\n",
        sweeps_, double(points_) / n, registration_ms_ / n, odometry_ms_ / n, mapping_ms_ / n,
        iterations_ / n);
  }

 private:
  std::size_t map_points() const { return mapper_.point_count(); }

  void write_row(const registration::RegistrationResult& f, const odometry::OdometryResult& r) {
    const auto& d = r.diagnostics;
    csv_ << r.sweep << ',' << int(r.health) << ',' << d.iterations << ',' << d.planes << ','
         << d.residual_m << ',' << d.prediction_error_m << ',' << d.prediction_error_rad << ','
         << r.degeneracy.degenerate << ',' << r.degeneracy.sigma_measured << ','
         << r.degeneracy.sigma_predicted << ',' << r.degeneracy.share << ',' << f.sharp.size()
         << ',' << f.less_sharp.size() << ',' << f.flat.size() << ',' << f.less_flat.size() << ','
         << f.diagnostics.measured_noise_m;
  }

  void map(const Scan& scan, const odometry::FeatureSweep& input,
           const odometry::OdometryResult& odom) {
    if (odom.new_frame) ++odom_epoch_;
    if (o_.gap_every > 0 && odom.sweep % o_.gap_every >= o_.gap_every - o_.gap_sweeps) {
      csv_ << ",,,,,,,,,,,,,,,,\n";
      return;
    }
    if (o_.with_mapping) {
      mapping::MappingInput m;
      m.sweep = odom.sweep;
      m.stamp_ns = input.stamp_ns;
      m.instant_ns = static_cast<std::uint32_t>(odom.instant_ns - input.stamp_ns);
      m.period_ns = scan.period_ns;
      m.odom_epoch = odom_epoch_;
      m.T_odom_base = odom.T_odom_base;
      m.twist_per_s = odom.twist_per_s;
      m.step_covariance = odom.covariance;
      m.inertial = odom.inertial_step;
      m.T_base_lidar = o_.T_base_lidar;
      m.edges = odom.edges;
      m.planes = odom.planes;
      m.health = odom.health;
      m.degenerate = odom.degeneracy.degenerate;
      m.range_noise_m = input.range_noise_m;
      m.slices = input.slices;
      const mapping::MappingResult r = mapper_.process(m);
      write_tum(est_file_, odom.instant_ns, r.T_map_base);
      if (r.submap) write_submap(submaps_file_, *r.submap);
      write_map_row(r, odom);
      fuse(odom, r);
      return;
    }
    write_tum(est_file_, odom.instant_ns, odom.T_odom_base);
    csv_ << ",,,,,,,,,,,,,,,,\n";
  }

  static void write_covariance(std::ofstream& file, std::uint64_t sweep, const Matrix6& c) {
    file << sweep;
    for (int i = 0; i < 36; ++i) file << ',' << c(i / 6, i % 6);
    file << '\n';
  }

  void write_map_row(const mapping::MappingResult& r, const odometry::OdometryResult& odom) {
    const mapping::Degeneracy& d = r.degeneracy;
    csv_ << ',' << int(r.health) << ',' << r.residual_m << ',' << d.degenerate << ','
         << d.sigma_measured << ',' << d.sigma_predicted << ',' << d.share << ','
         << d.weak_translation.x() << ',' << d.weak_translation.y() << ',' << d.weak_translation.z()
         << ',' << r.inserted;
    for (int i = 0; i < 3; ++i) csv_ << ',' << odom.degeneracy.weak_translation[i];
    csv_ << ',' << r.iterations << ',' << odom.diagnostics.imu_used << ','
         << odom.diagnostics.imu_contradictions << '\n';
    write_covariance(covariance_file_, r.sweep, r.covariance);
  }

  template <typename Degeneracy>
  static integration::Weak weak(const Degeneracy& d) {
    return {d.degenerate, d.weak_translation, d.weak_rotation, d.sigma_measured, d.sigma_predicted};
  }

  void fuse(const odometry::OdometryResult& odom, const mapping::MappingResult& r) {
    integration::OdometryPose pose;
    pose.sweep = odom.sweep;
    pose.instant_ns = odom.instant_ns;
    pose.odom_epoch = odom_epoch_;
    pose.T_odom_base = odom.T_odom_base;
    pose.twist_per_s = odom.twist_per_s;
    pose.step_covariance = odom.covariance;
    pose.health = odom.health;
    pose.weak = weak(odom.degeneracy);
    pose.replay = true;
    integration::Correction correction;
    correction.sweep = r.sweep;
    correction.odom_epoch = odom_epoch_;
    correction.T_map_odom = r.T_map_odom;
    correction.covariance = r.covariance;
    correction.health = r.health;
    correction.weak = weak(r.degeneracy);
    auto leaving = integrator_.add(pose);
    const auto later = integrator_.add(correction);
    leaving.insert(leaving.end(), later.begin(), later.end());
    for (const auto& f : leaving) write_fused(f);
  }

  void write_fused(const integration::FusedPose& f) {
    write_tum(fused_file_, f.instant_ns, f.T_map_base);
    fused_csv_ << f.sweep << ',' << int(f.health) << ',' << f.weak.degenerate;
    for (int i = 0; i < 3; ++i) fused_csv_ << ',' << f.weak.translation[i];
    fused_csv_ << ',' << f.jump << ',' << f.odometry_drifts << '\n';
    write_covariance(fused_covariance_file_, f.sweep, f.covariance);
  }

  const Options& o_;
  driver::ImuBuffer imu_{0};
  odometry::Odometry odometry_;
  mapping::Mapper mapper_;
  integration::Integrator integrator_;
  std::uint32_t odom_epoch_ = 0;
  ResultFile odom_file_, est_file_, fused_file_, csv_, covariance_file_, fused_csv_,
      fused_covariance_file_, cost_file_, submaps_file_;
  double registration_ms_ = 0.0;
  double odometry_ms_ = 0.0;
  double mapping_ms_ = 0.0;
  double iterations_ = 0.0;
  std::size_t sweeps_ = 0;
  std::size_t points_ = 0;
};

int run(const std::vector<std::string>& args) {
  const Options options = parse_options(args);
  ScanReader reader(options.input, options.reading);
  Run run(options);
  reader.write_truth(options.out);
  Scan scan;
  for (std::size_t i = 0; reader.next(scan); ++i) {
    if (i < options.first) continue;
    if (i - options.first >= options.count) break;
    thin_out(scan, options.thin);
    run.sweep(i, scan);
  }
  run.finish();
  run.summary();
  return 0;
}

}  // namespace
}  // namespace zloam::offline

int main(int argc, char** argv) {
  return zloam::offline::run_main("zloam-offline", argc, argv, zloam::offline::run);
}
