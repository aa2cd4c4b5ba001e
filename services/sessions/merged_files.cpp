#include "sessions/merged_files.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <nlohmann/json.hpp>
#include <sstream>

#include "common/geometry/atomic_file.hpp"
#include "common/geometry/trajectory.hpp"
#include "graph/world_map.hpp"

namespace zloam::sessions {
namespace {

using nlohmann::json;

json pose_json(const Pose& pose) {
  const Eigen::Vector3d& t = pose.translation();
  const Eigen::Quaterniond q(pose.linear());
  return {{"xyz_m", {t.x(), t.y(), t.z()}}, {"quaternion_xyzw", {q.x(), q.y(), q.z(), q.w()}}};
}

/// Formats a pose as x y z qx qy qz qw.
std::string pose_text(const Pose& pose) {
  const Eigen::Vector3d& t = pose.translation();
  const Eigen::Quaterniond q(pose.linear());
  std::ostringstream out;
  out.precision(12);
  for (const double v : {t.x(), t.y(), t.z(), q.x(), q.y(), q.z()}) out << v << ' ';
  out << q.w();
  return out.str();
}

/// g2o's error is the translation and the vector part of the quaternion, which is half the
/// rotation.
std::string information_text(const Matrix6& covariance) {
  Matrix6 half = Matrix6::Identity();
  half.diagonal().tail<3>().setConstant(0.5);
  const Matrix6 scaled = half * covariance * half;
  const Matrix6 information = scaled.ldlt().solve(Matrix6::Identity());
  std::ostringstream out;
  out.precision(12);
  for (int row = 0; row < 6; ++row) {
    for (int column = row; column < 6; ++column) {
      out << ' ' << 0.5 * (information(row, column) + information(column, row));
    }
  }
  return out.str();
}

json session_json(const Merged& merged, std::size_t session) {
  const SavedMap& map = merged.maps[session];
  std::size_t points = 0;
  for (const Submap& submap : map.submaps) points += submap.points.size();
  // A merged map holds drives of the same time.
  const auto [first, last] = std::ranges::minmax_element(map.submaps, {}, &Submap::instant_ns);
  json out = {{"folder", map.folder.string()},
              {"robot", map.robot},
              {"run", map.run},
              {"submaps", map.submaps.size()},
              {"points", points},
              {"from_ns", first->instant_ns},
              {"to_ns", last->instant_ns},
              {"unread_bytes", map.unread_bytes},
              {"unread_files", map.unread_files},
              {"unread_records", map.unread_records},
              {"damaged", map.damaged},
              {"joined", merged.is_joined(session)}};
  for (const graph::Node& node : merged.graph.nodes()) {
    if (node.session != session) continue;
    // Pose of the session's map, derived from its first submap.
    if (!out.contains("T_world_map")) {
      out["T_world_map"] = pose_json(node.T_world_submap * node.T_map_submap.inverse());
    }
    out["way_m"] = node.way_m;
  }
  return out;
}

}  // namespace

std::vector<Merged::Placed> Merged::placed() const {
  std::vector<Placed> out;
  std::vector<std::size_t> next_of(maps.size(), 0);
  for (const graph::Node& node : graph.nodes()) {
    const std::size_t index = next_of[node.session]++;
    if (is_joined(node.session)) out.push_back({node.session, index, node.T_world_submap});
  }
  return out;
}

std::string write_submap_poses(const Merged& merged, const std::filesystem::path& folder) {
  for (std::size_t session = 0; session < merged.maps.size(); ++session) {
    Trajectory poses;
    for (const graph::Node& node : merged.graph.nodes()) {
      if (node.session == session) poses.push_back({node.instant_ns, node.T_world_submap});
    }
    const std::string name = "submaps_" + std::to_string(session + 1) + ".tum";
    TrajectoryText text(poses, tum_line);
    const std::string error =
        write_file_atomically((folder / name).string(), [&] { return text.next(); });
    if (!error.empty()) return error;
  }
  return {};
}

std::string write_g2o(const Merged& merged, const std::filesystem::path& path) {
  std::ostringstream out;
  const std::vector<graph::Node>& nodes = merged.graph.nodes();
  for (std::size_t i = 0; i < nodes.size(); ++i) {
    out << "VERTEX_SE3:QUAT " << i << ' ' << pose_text(nodes[i].T_world_submap) << '\n';
  }
  for (const graph::Between& factor : merged.graph.factors()) {
    out << "EDGE_SE3:QUAT " << factor.from << ' ' << factor.to << ' ' << pose_text(factor.T_from_to)
        << information_text(factor.covariance) << '\n';
  }
  return write_file_atomically(path.string(), out.str());
}

std::string write_points(const Merged& merged, const std::filesystem::path& path) {
  const std::vector<Merged::Placed> parts = merged.placed();
  const auto submap_of = [&](const Merged::Placed& part) -> const Submap& {
    return merged.maps[part.session].submaps[part.index];
  };
  std::size_t count = 0;
  for (const Merged::Placed& part : parts) count += submap_of(part).points.size();
  std::size_t at = 0;
  return graph::write_world_map(path.string(), count, [&]() -> std::optional<graph::PlacedPoints> {
    if (at == parts.size()) return std::nullopt;
    const Merged::Placed& part = parts[at++];
    return graph::PlacedPoints{submap_of(part).points, part.T_world_submap};
  });
}

std::string write_report(const Merged& merged, const std::filesystem::path& path) {
  json report = {{"sessions", json::array()}, {"loops", json::array()}};
  for (std::size_t i = 0; i < merged.maps.size(); ++i) {
    report["sessions"].push_back(session_json(merged, i));
  }
  const std::vector<graph::Node>& nodes = merged.graph.nodes();
  for (const graph::Loop& loop : merged.graph.loops()) {
    if (loop.verdict != graph::Verdict::kAccepted) continue;
    report["loops"].push_back({{"from_session", nodes[loop.from].session},
                               {"from_sweep", nodes[loop.from].sweep},
                               {"to_session", nodes[loop.to].session},
                               {"to_sweep", nodes[loop.to].sweep},
                               {"overlap", loop.overlap},
                               {"residual_m", loop.residual_m},
                               {"T_from_to", pose_json(loop.T_from_to)}});
  }
  // A folder's name may be no UTF-8.
  const std::string text = report.dump(2, ' ', false, json::error_handler_t::replace);
  return write_file_atomically(path.string(), text + "\n");
}

}  // namespace zloam::sessions
