// zloam-kidnap MAP DRIVE OUTSIDE OUT.csv [--count N] [--seed N] [--sweeps N]
//
// Simulates a kidnapped robot. The map is made from the first capture and does not change after
// that. Then, N times, the robot is put down with a random heading somewhere on the second drive,
// through the same world, or one time in ten on the third drive, through another world. It gets no
// hint. Every other time its odometry restarts, otherwise it continues as if nothing had happened;
// up to 20 s pass without a sweep. Registration and odometry process the drives unchanged; only the
// input of mapping is transformed.
//
// Writes a row for each sweep: kidnap, outside, heading_rad, sweeps since the kidnap, instant_ns of
// the drive's pose, health, pose. The poses are those of a base_link rotated by heading_rad against
// the drive's, in the frame of the first capture's first pose.

#include <cmath>
#include <cstdio>
#include <map>
#include <numbers>
#include <random>
#include <stdexcept>
#include <string>
#include <vector>

#include "common/geometry/se3.hpp"
#include "mapping/mapping.hpp"
#include "mapping/mapping_parameters.hpp"
#include "odometry/odometry.hpp"
#include "registration/registration.hpp"
#include "run_files.hpp"
#include "scan_reader.hpp"

namespace zloam::offline {
namespace {

// Time without sweeps while the robot is carried.
constexpr double kLeastAway_s = 0.1, kMostAway_s = 20.0;

/// Mapping's input for one sweep, with the points that it refers to.
struct Sweep {
  mapping::MappingInput input;
  PointVector edges, planes;

  std::int64_t instant_ns() const { return input.stamp_ns + input.instant_ns; }
  mapping::MappingInput with_points() const {
    mapping::MappingInput out = input;
    out.edges = edges;
    out.planes = planes;
    return out;
  }
};

/// Passes each sweep of a capture, as odometry publishes it, to `take`.
template <typename Take>
void drive(const std::string& path, const Take& take) {
  ScanReader reader(path, {});
  odometry::Odometry odometry(odometry::OdometryConfig{}, Pose::Identity(), Pose::Identity());
  const registration::RegistrationConfig registration;
  Scan scan;
  for (std::uint64_t number = 0; reader.next(scan); ++number) {
    const auto features =
        registration::extract_features(scan.points, {scan.period_ns, scan.rings}, registration);
    odometry::FeatureSweep input;
    input.sweep = number;
    input.stamp_ns = scan.stamp_ns;
    input.period_ns = scan.period_ns;
    input.range_noise_m = registration.range_noise_m;
    input.less_sharp = features.less_sharp;
    input.less_flat = features.less_flat;
    const auto odom = odometry.process(input);
    Sweep s;
    mapping::MappingInput& m = s.input;
    m.sweep = number;
    m.stamp_ns = scan.stamp_ns;
    m.instant_ns = static_cast<std::uint32_t>(odom.instant_ns - scan.stamp_ns);
    m.period_ns = scan.period_ns;
    m.T_odom_base = odom.T_odom_base;
    m.twist_per_s = odom.twist_per_s;
    m.step_covariance = odom.covariance;
    m.health = odom.health;
    m.degenerate = odom.degeneracy.degenerate;
    m.range_noise_m = registration.range_noise_m;
    s.edges.assign(odom.edges.begin(), odom.edges.end());
    s.planes.assign(odom.planes.begin(), odom.planes.end());
    take(s);
  }
}

mapping::SavedMap map_of(const std::string& path) {
  mapping::Mapper mapper{mapping::MappingConfig{}};
  mapping::SavedMap saved;
  // Tiles are collected as the store does it, because mapping drops voxels that lie far behind.
  std::map<mapping::TileIndex, mapping::VoxelTile> voxels;
  const auto publish = [&](double growth) {
    for (auto& tile : mapper.take_changed_voxels(growth)) {
      const auto index = tile.index;
      voxels.insert_or_assign(index, std::move(tile));
    }
  };
  const mapping::OutputConfig output;
  drive(path, [&](const Sweep& s) {
    const auto result = mapper.process(s.with_points());
    saved.instant_ns = s.instant_ns();
    saved.T_map_base = result.T_map_base;
    if ((s.input.sweep + 1) % output.voxels_every == 0) publish(output.voxels_growth);
  });
  publish(0.0);
  for (const auto& id : mapper.tiles()) saved.tiles.push_back(*mapper.tile(id));
  for (auto& [index, tile] : voxels) saved.voxels.push_back(std::move(tile));
  return saved;
}

void turn(PointVector& points, const Eigen::Matrix3f& R) {
  for (Point& p : points) {
    const Eigen::Vector3f turned = R * p.position();
    p.x = turned.x();
    p.y = turned.y();
    p.z = turned.z();
  }
}

/// The sweep of a robot whose odom frame differs and whose base_link is turned by T_turned_base.
Sweep carried_to(Sweep s, const Pose& T_odom_drive, const Pose& T_turned_base) {
  mapping::MappingInput& m = s.input;
  m.T_odom_base = normalised(T_odom_drive * m.T_odom_base * T_turned_base.inverse());
  Vector6 twist;
  twist << T_turned_base.linear() * m.twist_per_s.head<3>(),
      T_turned_base.linear() * m.twist_per_s.tail<3>();
  m.twist_per_s = twist;
  m.step_covariance = carried(m.step_covariance, T_turned_base.inverse());
  turn(s.edges, T_turned_base.linear().cast<float>());
  turn(s.planes, T_turned_base.linear().cast<float>());
  return s;
}

struct Options {
  std::string map, drive, outside, out;
  int count = 100;
  unsigned seed = 1;
  std::size_t sweeps = 60;
};

Options parse_options(const std::vector<std::string>& args) {
  Options o;
  std::vector<std::string> positional;
  for (std::size_t i = 0; i < args.size(); ++i) {
    if (args[i] == "--count") {
      o.count = std::stoi(args.at(++i));
    } else if (args[i] == "--seed") {
      o.seed = static_cast<unsigned>(std::stoul(args.at(++i)));
    } else if (args[i] == "--sweeps") {
      o.sweeps = std::stoul(args.at(++i));
    } else {
      add_positional(positional, args[i]);
    }
  }
  if (positional.size() != 4) {
    throw std::invalid_argument("usage: zloam-kidnap MAP DRIVE OUTSIDE OUT.csv [--count N]");
  }
  o.map = positional[0];
  o.drive = positional[1];
  o.outside = positional[2];
  o.out = positional[3];
  return o;
}

std::vector<Sweep> sweeps_of(const std::string& path) {
  std::vector<Sweep> sweeps;
  drive(path, [&](const Sweep& s) { sweeps.push_back(s); });
  return sweeps;
}

double yaw_of(const Pose& T) { return std::atan2(T.linear()(1, 0), T.linear()(0, 0)); }

Pose turned_by(double yaw_rad) {
  Pose T = Pose::Identity();
  T.linear() = Eigen::AngleAxisd(yaw_rad, Eigen::Vector3d::UnitZ()).toRotationMatrix();
  return T;
}

class Robot {
 public:
  Robot(const Options& options, const mapping::SavedMap& saved)
      : o_(options), mapper_(localizing()), random_(options.seed), out_(options.out) {
    mapper_.restore(saved);
    T_odom_base_ = saved.T_map_base;
    now_ns_ = saved.instant_ns;
    out_ << "kidnap,outside,heading_rad,since,instant_ns,health,x,y,z,qx,qy,qz,qw\n";
  }

  void finish() { out_.finish(); }

  /// Puts the robot down somewhere on the drive.
  void carry(int kidnap, const std::vector<Sweep>& sweeps, bool is_outside) {
    constexpr double kBegun = 10.0;  // after this many sweeps the odometry has settled
    const auto most = static_cast<double>(sweeps.size() - o_.sweeps - 1);
    const auto first = static_cast<std::size_t>(uniform(kBegun, most));
    const double heading_rad = uniform(-std::numbers::pi, std::numbers::pi);
    const Pose T_turned_base = turned_by(heading_rad);
    const bool begins_again = kidnap % 2 == 1;
    if (begins_again) ++epoch_;
    const Pose T_odom_drive = frame_from(begins_again ? Pose::Identity() : T_odom_base_,
                                         sweeps[first].input.T_odom_base * T_turned_base.inverse());
    const double away_s = uniform(kLeastAway_s, kMostAway_s);
    const std::int64_t shift_ns =
        now_ns_ + static_cast<std::int64_t>(1e9 * away_s) - sweeps[first].input.stamp_ns;
    for (std::size_t i = 0; i < o_.sweeps; ++i) {
      Sweep s = carried_to(sweeps[first + i], T_odom_drive, T_turned_base);
      const std::int64_t instant_ns = s.instant_ns();
      s.input.stamp_ns += shift_ns;
      char head[80];
      std::snprintf(head, sizeof head, "%d,%d,%.9f,%zu,%lld", kidnap, is_outside ? 1 : 0,
                    heading_rad, i, static_cast<long long>(instant_ns));
      see(s, head);
    }
  }

  void summary() const {
    std::printf("CPU ms/sweep %.1f, at most %.0f\n", total_ms_ / static_cast<double>(number_),
                worst_ms_);
  }

 private:
  static mapping::MappingConfig localizing() {
    mapping::MappingConfig config;
    config.mode = mapping::MappingMode::kLocalize;
    return config;
  }

  double uniform(double low, double high) {
    return std::uniform_real_distribution<double>(low, high)(random_);
  }

  /// T_odom_drive, level, so that T_odom_drive * T_drive_base has the position and yaw of
  /// T_odom_base.
  static Pose frame_from(const Pose& T_odom_base, const Pose& T_drive_base) {
    Pose T = turned_by(yaw_of(T_odom_base) - yaw_of(T_drive_base));
    T.translation() = T_odom_base.translation() - T.linear() * T_drive_base.translation();
    return T;
  }

  void see(const Sweep& s, const char* head) {
    mapping::MappingInput input = s.with_points();
    input.sweep = number_++;
    input.odom_epoch = epoch_;
    const double before_ms = cpu_ms();
    const auto r = mapper_.process(input);
    const double took_ms = cpu_ms() - before_ms;
    total_ms_ += took_ms;
    worst_ms_ = std::max(worst_ms_, took_ms);
    const Eigen::Quaterniond q(r.T_map_base.linear());
    const Eigen::Vector3d t = r.T_map_base.translation();
    char pose[160];
    std::snprintf(pose, sizeof pose, ",%d,%.6f,%.6f,%.6f,%.9f,%.9f,%.9f,%.9f\n",
                  static_cast<int>(r.health), t.x(), t.y(), t.z(), q.x(), q.y(), q.z(), q.w());
    out_ << head << pose;
    T_odom_base_ = input.T_odom_base;
    now_ns_ = s.instant_ns();
  }

  const Options& o_;
  mapping::Mapper mapper_;
  std::mt19937 random_;
  ResultFile out_;
  Pose T_odom_base_ = Pose::Identity();
  std::uint64_t number_ = 0;
  std::uint32_t epoch_ = 1;
  std::int64_t now_ns_ = 0;
  double total_ms_ = 0.0, worst_ms_ = 0.0;
};

int run(const std::vector<std::string>& args) {
  const Options o = parse_options(args);
  Robot robot(o, map_of(o.map));
  const std::vector<Sweep> inside = sweeps_of(o.drive), outside = sweeps_of(o.outside);
  for (const auto* sweeps : {&inside, &outside}) {
    if (sweeps->size() < o.sweeps + 20) throw std::invalid_argument("a drive is too short");
  }
  for (int k = 0; k < o.count; ++k) {
    const bool is_outside = k % 10 == 9;
    robot.carry(k, is_outside ? outside : inside, is_outside);
  }
  robot.finish();
  robot.summary();
  return 0;
}

}  // namespace
}  // namespace zloam::offline

int main(int argc, char** argv) {
  return zloam::offline::run_main("zloam-kidnap", argc, argv, zloam::offline::run);
}
