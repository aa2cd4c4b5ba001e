// zloam-graph-offline SUBMAPS EST OUT [--drift SHARE RAD_PER_M SEED] [--points FILE]
//
// Runs the pose graph over the submaps written by zloam-offline --submaps, without messages. Writes
// the poses of EST with the drift of --drift but without loops (chain.tum) and corrected by the
// graph (graph.tum), the submaps' poses before the graph (submaps.tum) and loops.csv, and prints
// the CPU time. --drift adds errors to the motion between submaps (one sigma: a share of the
// travel, and rad per metre) and increases the covariance accordingly. --points writes all points
// as float32: x y z in the map by mapping, and 1 for points classified as moving, else 0.

#include <cstdio>
#include <fstream>
#include <random>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

#include "graph/loop_graph.hpp"
#include "run_files.hpp"
#include "sessions/standing.hpp"
#include "submap_file.hpp"

namespace zloam::offline {
namespace {

struct Options {
  std::string submaps, est, out, points;
  double drift_share = 0.0, drift_rad_per_m = 0.0;
  unsigned seed = 1;
};

Options parse_options(const std::vector<std::string>& args) {
  Options o;
  std::vector<std::string> positional;
  for (std::size_t i = 0; i < args.size(); ++i) {
    if (args[i] == "--drift") {
      o.drift_share = std::stod(args.at(++i));
      o.drift_rad_per_m = std::stod(args.at(++i));
      o.seed = static_cast<unsigned>(std::stoul(args.at(++i)));
    } else if (args[i] == "--points") {
      o.points = args.at(++i);
    } else {
      add_positional(positional, args[i]);
    }
  }
  if (positional.size() != 3) {
    throw std::invalid_argument(
        "usage: zloam-graph-offline SUBMAPS EST OUT [--drift SHARE RAD_PER_M SEED] [--points "
        "FILE]");
  }
  o.submaps = positional[0];
  o.est = positional[1];
  o.out = positional[2];
  return o;
}

struct StampedPose {
  std::int64_t stamp_ns;
  Pose pose;
};

std::vector<StampedPose> read_tum(const std::string& path) {
  std::ifstream file(path);
  if (!file) throw std::runtime_error(path + ": can't be read");
  std::vector<StampedPose> all;
  std::string line;
  while (std::getline(file, line)) {
    std::istringstream text(line);
    std::string stamp;
    double v[7];
    text >> stamp;
    for (double& x : v) text >> x;
    StampedPose p{0, Pose::Identity()};
    const auto dot = stamp.find('.');
    p.stamp_ns =
        std::stoll(stamp.substr(0, dot)) * 1'000'000'000 + std::stoll(stamp.substr(dot + 1));
    p.pose.translation() << v[0], v[1], v[2];
    p.pose.linear() = Eigen::Quaterniond(v[6], v[3], v[4], v[5]).normalized().toRotationMatrix();
    all.push_back(p);
  }
  return all;
}

/// Adds a random drift to the submaps' poses.
class Drift {
 public:
  explicit Drift(const Options& o) : o_(o), random_(o.seed) {}
  void spoil(Submap& submap) {
    if (o_.drift_share == 0.0 && o_.drift_rad_per_m == 0.0) return;
    const double sigma_m = o_.drift_share * submap.step_m;
    const double sigma_rad = o_.drift_rad_per_m * submap.step_m;
    std::normal_distribution<double> normal;
    Vector6 error = Vector6::Zero();
    error(0) = sigma_m * normal(random_);
    error(1) = sigma_m * normal(random_);
    error(2) = 0.3 * sigma_m * normal(random_);
    error(5) = sigma_rad * normal(random_);
    // The error is applied to the motion since the previous submap, so it moves all later ones too.
    const Pose T_before_now = before_.inverse() * submap.T_map_submap;
    before_ = submap.T_map_submap;
    now_ = normalised(now_ * T_before_now * exp_se3(error));
    submap.T_map_submap = now_;
    Matrix6 more = Matrix6::Zero();
    more.diagonal() << sigma_m * sigma_m, sigma_m * sigma_m, 0.1 * sigma_m * sigma_m, 1e-8, 1e-8,
        sigma_rad * sigma_rad;
    submap.step_covariance += more;
  }

 private:
  const Options& o_;
  std::mt19937_64 random_;
  Pose before_ = Pose::Identity(), now_ = Pose::Identity();
};

void write_points(const std::string& path, const std::vector<Submap>& submaps) {
  ResultFile file(path, std::ios::binary);
  double spent_ms = 0.0;
  for (const Submap& submap : submaps) {
    const double before_ms = cpu_ms();
    const std::vector<bool> moving = sessions::moving_points(submap);
    spent_ms += cpu_ms() - before_ms;
    for (std::size_t i = 0; i < moving.size(); ++i) {
      const MapPoint& p = submap.points[i];
      const Eigen::Vector3f at =
          (submap.T_map_submap * Eigen::Vector3d(p.x, p.y, p.z)).cast<float>();
      for (const float value : {at.x(), at.y(), at.z(), moving[i] ? 1.0F : 0.0F}) {
        submap_file::put(file, value);
      }
    }
  }
  file.finish();
  std::printf("what moved: CPU ms/submap %.1f\n",
              spent_ms / static_cast<double>(std::max<std::size_t>(1, submaps.size())));
}

int run(const std::vector<std::string>& args) {
  const Options options = parse_options(args);
  const std::vector<Submap> submaps = read_submaps(options.submaps);
  if (!options.points.empty()) write_points(options.points, submaps);
  std::vector<StampedPose> est = read_tum(options.est);
  graph::LoopGraph graph{graph::GraphConfig{}};
  ResultFile loops(options.out + "/loops.csv");
  loops << "from,to,from_sweep,to_sweep,verdict,overlap,residual_m,chi2,x,y,z,qx,qy,qz,qw\n";
  Drift drift(options);
  std::vector<Pose> unspoilt;
  double worst_ms = 0.0;
  const double begin_ms = cpu_ms();
  for (Submap submap : submaps) {
    unspoilt.push_back(submap.T_map_submap);
    drift.spoil(submap);
    const double before_ms = cpu_ms();
    const graph::Update update = graph.add(submap);
    worst_ms = std::max(worst_ms, cpu_ms() - before_ms);
    for (const graph::Loop& loop : update.loops) {
      const auto& t = loop.T_from_to.translation();
      const Eigen::Quaterniond q(loop.T_from_to.linear());
      loops << loop.from << ',' << loop.to << ',' << graph.nodes()[loop.from].sweep << ','
            << graph.nodes()[loop.to].sweep << ',' << graph::verdict_name(loop.verdict) << ','
            << loop.overlap << ',' << loop.residual_m << ',' << loop.chi2 << ',' << t.x() << ','
            << t.y() << ',' << t.z() << ',' << q.x() << ',' << q.y() << ',' << q.z() << ',' << q.w()
            << '\n';
    }
  }
  const double spent_ms = cpu_ms() - begin_ms;
  ResultFile chain(options.out + "/chain.tum"), corrected(options.out + "/graph.tum");
  const auto& nodes = graph.nodes();
  ResultFile submap_poses(options.out + "/submaps.tum");
  for (const graph::Node& node : nodes) write_tum(submap_poses, node.instant_ns, node.T_map_submap);
  std::size_t next = 0;
  for (std::size_t sweep = 0; sweep < est.size(); ++sweep) {
    while (next + 1 < nodes.size() && nodes[next + 1].sweep <= sweep) ++next;
    const Pose spoilt = nodes[next].T_map_submap * unspoilt[next].inverse() * est[sweep].pose;
    write_tum(chain, est[sweep].stamp_ns, spoilt);
    write_tum(corrected, est[sweep].stamp_ns, graph.corrected(est[sweep].stamp_ns, spoilt));
  }
  for (ResultFile* file : {&loops, &chain, &corrected, &submap_poses}) file->finish();
  std::size_t accepted = 0;
  for (const graph::Loop& loop : graph.loops())
    accepted += loop.verdict == graph::Verdict::kAccepted;
  std::printf(
      "submaps %zu, loops %zu, revision %u, chi2 %.3f -> %.3f, CPU ms/submap %.1f, worst %.1f\n",
      nodes.size(), accepted, graph.revision(), graph.chi2_before(), graph.chi2_after(),
      spent_ms / static_cast<double>(std::max<std::size_t>(1, nodes.size())), worst_ms);
  return 0;
}

}  // namespace
}  // namespace zloam::offline

int main(int argc, char** argv) {
  return zloam::offline::run_main("zloam-graph-offline", argc, argv, zloam::offline::run);
}
