#include "mapping/submap_builder.hpp"

#include <algorithm>
#include <cmath>

#include "mapping/grid_index.hpp"

namespace zloam::mapping {
namespace {

// Fine enough to fit planes of 1 m to the remaining points.
constexpr double kLeaf_m = 0.3;
// A degenerate sweep adds its covariance only after this motion since the last one that was
// considered: at rest the same points are matched to the same map again.
constexpr double kMoved_m = 0.1, kMoved_rad = 0.02;
// With fewer points a submap cannot identify a place.
constexpr std::size_t kFewestPoints = 300;
constexpr std::size_t kMostGroups = 64;

/// Merges each pair of neighbouring bits into one.
std::uint64_t joined_in_pairs(std::uint64_t bits) {
  std::uint64_t out = 0;
  for (unsigned i = 0; i < kMostGroups / 2; ++i) {
    if ((bits >> (2 * i) & 3U) != 0) out |= std::uint64_t{1} << i;
  }
  return out;
}

}  // namespace

void SubmapBuilder::move(const SubmapInput& input) {
  if (T_map_base_before_) {
    const Pose T_now_before = input.T_map_base.inverse() * *T_map_base_before_;
    open_ = carried(open_, T_now_before);
    unfound_ = carried(unfound_, T_now_before);
    frame_ = carried(frame_, T_now_before);
    since_m_ += T_now_before.translation().norm();
  } else {
    counted_at_ = input.T_map_base.translation();
    counted_turn_ = input.T_map_base.linear();
  }
  T_map_base_before_ = input.T_map_base;
  connected_ = connected_ && input.found;
  if (!input.found) {
    // The covariance of an unmatched pose grows from sweep to sweep: the last one contains them
    // all.
    unfound_ = input.covariance;
    return;
  }
  const double moved_m = (input.T_map_base.translation() - counted_at_).norm();
  const double turned_rad = log_so3(counted_turn_.transpose() * input.T_map_base.linear()).norm();
  if (moved_m < kMoved_m && turned_rad < kMoved_rad) return;
  // Where the points constrain the pose, only the matches at both ends are uncertain; where they do
  // not, each sweep adds its own covariance.
  if (input.degenerate) open_ += input.covariance;
  counted_at_ = input.T_map_base.translation();
  counted_turn_ = input.T_map_base.linear();
}

// Bit of the newest sweep. If there are more sweeps than bits, groups of sweeps share a bit.
std::uint64_t SubmapBuilder::next_hit() {
  if ((steps_.size() - 1) / group_ == kMostGroups) {
    group_ *= 2;
    for (Voxel& voxel : voxels_) voxel.hits = joined_in_pairs(voxel.hits);
  }
  return std::uint64_t{1} << ((steps_.size() - 1) / group_);
}

std::vector<Eigen::Vector3d> SubmapBuilder::origins(const Pose& T_submap_map) const {
  std::vector<Eigen::Vector3d> out;
  for (std::size_t first = 0; first < steps_.size(); first += group_) {
    const std::size_t last = std::min(first + group_, steps_.size()) - 1;
    const Step& step = steps_[(first + last) / 2];
    out.emplace_back(T_submap_map * step.T_map_base * step.origin_base);
  }
  return out;
}

void SubmapBuilder::take(PointSpan points, const Pose& T_first_base, std::uint64_t hit) {
  for (const Point& point : points) {
    const Eigen::Vector3d p = T_first_base * point.position().cast<double>();
    if (!p.allFinite()) continue;
    const std::uint64_t key = pack_key(grid_index(p, kLeaf_m));
    std::uint32_t place = places_.find(key);
    if (place == FlatIndex::kNone) {
      place = static_cast<std::uint32_t>(voxels_.size());
      places_.insert(key, place);
      voxels_.emplace_back();
    }
    Voxel& voxel = voxels_[place];
    voxel.sum += p;
    // As in the map's tiles: one point without an intensity leaves the voxel its own.
    if (std::isfinite(point.intensity)) voxel.intensity += static_cast<double>(point.intensity);
    ++voxel.count;
    voxel.hits |= hit;
  }
}

std::optional<Submap> SubmapBuilder::add(const SubmapInput& input) {
  if (!(way_m_ > 0.0)) return std::nullopt;
  std::optional<Submap> closed;
  // The sweeps after an unmatched one may be displaced against the submap, so it ends here.
  if (!input.found) closed = finish();
  move(input);
  if (!input.found) return closed;
  const double step_m =
      steps_.empty()
          ? 0.0
          : (input.T_map_base.translation() - steps_.back().T_map_base.translation()).norm();
  const double way_m = steps_.empty() ? 0.0 : steps_.back().way_m + step_m;
  const Matrix6 open = open_ + unfound_;
  steps_.push_back({input.sweep, input.instant_ns, input.T_map_base, way_m, input.covariance, open,
                    frame_ + open + input.covariance, since_m_, connected_, input.origin_base});
  range_noise_m_ = input.range_noise_m;
  const Pose T_first_base = steps_.front().T_map_base.inverse() * input.T_map_base;
  const std::uint64_t hit = next_hit();
  take(input.edges, T_first_base, hit);
  take(input.planes, T_first_base, hit);
  if (way_m >= way_m_) closed = close();
  return closed;
}

std::optional<Submap> SubmapBuilder::finish() {
  if (!steps_.empty() && voxels_.size() >= kFewestPoints) return close();
  clear();
  return std::nullopt;
}

// A submap is published with the sweep that ends it, and is invalid if it has a higher number. The
// number of the submap before stays: its reader knows it by that one.
void SubmapBuilder::new_run() {
  for (Step& step : steps_) step.sweep = 0;
}

void SubmapBuilder::clear() {
  steps_.clear();
  voxels_.clear();
  places_ = FlatIndex();
  group_ = 1;
}

Submap SubmapBuilder::close() {
  std::size_t middle = 0;
  while (2.0 * steps_[middle].way_m < steps_.back().way_m) ++middle;
  const Step& frame = steps_[middle];
  Submap out;
  out.first_sweep = steps_.front().sweep;
  out.last_sweep = steps_.back().sweep;
  out.sweep = frame.sweep;
  out.before_sweep = before_sweep_.value_or(frame.sweep);
  before_sweep_ = frame.sweep;
  out.instant_ns = frame.instant_ns;
  out.T_map_submap = frame.T_map_base;
  out.step_covariance = frame.covariance;
  out.step_m = frame.since_m;
  out.connected = frame.connected;
  out.range_noise_m = range_noise_m_;
  const Pose T_submap_first = frame.T_map_base.inverse() * steps_.front().T_map_base;
  out.points.reserve(voxels_.size());
  out.hits.reserve(voxels_.size());
  out.origins = origins(frame.T_map_base.inverse());
  for (const Voxel& voxel : voxels_) {
    const Eigen::Vector3f p = (T_submap_first * (voxel.sum / voxel.count)).cast<float>();
    out.points.push_back({p.x(), p.y(), p.z(), static_cast<float>(voxel.intensity / voxel.count)});
    out.hits.push_back(voxel.hits);
  }
  // The motion after the frame's sweep belongs to the next submap.
  const Pose T_now_frame = steps_.back().T_map_base.inverse() * frame.T_map_base;
  frame_ = carried(frame.own, T_now_frame);
  open_ = open_ + unfound_ - carried(frame.open, T_now_frame);
  unfound_.setZero();
  since_m_ -= frame.since_m;
  connected_ = true;
  clear();
  return out;
}

}  // namespace zloam::mapping
