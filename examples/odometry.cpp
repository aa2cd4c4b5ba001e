// KITTI scans in, a trajectory out, with nothing but the installed library (docs/library.md):
//   odometry velodyne/ poses.tum
#include <algorithm>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <mapping/mapping.hpp>
#include <numbers>
#include <odometry/odometry.hpp>
#include <registration/registration.hpp>

namespace {
constexpr std::uint32_t kPeriod_ns = 100'000'000;
/// Records of x, y, z, intensity. The sensor turns clockwise and a scan begins at its rear.
zloam::PointVector read_scan(const std::filesystem::path& path) {
  std::ifstream file(path, std::ios::binary);
  zloam::PointVector points;
  for (float r[4]; file.read(reinterpret_cast<char*>(r), sizeof r);) {
    const double turned = 0.5 - std::atan2(r[1], r[0]) / (2.0 * std::numbers::pi);
    points.push_back({r[0], r[1], r[2], r[3], static_cast<std::uint32_t>(turned * kPeriod_ns), 0,
                      zloam::ReturnType::kStrongest, 0});
  }
  std::ranges::stable_sort(points, {}, &zloam::Point::time_ns);
  return points;
}
}  // namespace
int main(int count, char** arguments) {
  if (count != 3) return std::cerr << "usage: odometry FOLDER POSES.tum\n", 2;
  std::vector<std::filesystem::path> paths;
  for (const auto& entry : std::filesystem::directory_iterator(arguments[1])) {
    if (entry.path().extension() == ".bin") paths.push_back(entry.path());
  }
  std::ranges::sort(paths);
  std::ofstream out(arguments[2]);
  zloam::odometry::Odometry odometry({}, zloam::Pose::Identity());
  zloam::mapping::Mapper mapper({});
  for (std::uint64_t n = 0; n < paths.size(); ++n) {
    const zloam::PointVector scan = read_scan(paths[n]);
    // rings: 0, a KITTI scan does not tell them
    const auto features = zloam::registration::extract_features(scan, {kPeriod_ns, 0}, {});
    zloam::odometry::FeatureSweep sweep{n, static_cast<std::int64_t>(n * kPeriod_ns), kPeriod_ns};
    sweep.less_sharp = features.less_sharp;
    sweep.less_flat = features.less_flat;
    const auto moved = odometry.process(sweep);
    zloam::mapping::MappingInput input{n, sweep.stamp_ns};
    input.instant_ns = static_cast<std::uint32_t>(moved.instant_ns - sweep.stamp_ns);
    input.period_ns = kPeriod_ns;
    input.T_odom_base = moved.T_odom_base;
    input.twist_per_s = moved.twist_per_s;
    input.step_covariance = moved.covariance;
    input.edges = moved.edges;
    input.planes = moved.planes;
    const auto mapped = mapper.process(input);
    const Eigen::Quaterniond q(mapped.T_map_base.linear());
    out << 1e-9 * static_cast<double>(moved.instant_ns) << ' '
        << mapped.T_map_base.translation().transpose() << ' ' << q.coeffs().transpose() << '\n';
  }
  std::cout << paths.size() << " poses\n";
  return paths.empty() || !out ? 1 : 0;
}
