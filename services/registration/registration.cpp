#include "registration/registration.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <numbers>
#include <span>

#include "common/containers/thinning.hpp"
#include "common/geometry/lanes.hpp"
#include "registration/curvature.hpp"

namespace zloam::registration {
namespace {

enum Label : std::uint8_t { kNone = 0, kSharp = 1, kLessSharp = 2, kFlat = 4 };

// Larger than any chi2: marks points that can't be picked as flat.
constexpr float kNever = std::numeric_limits<float>::infinity();

bool is_unreliable(Kind kind) { return kind == Kind::kParallel || kind == Kind::kOccluded; }

// Picks features ring by ring, segment by segment.
class Picker {
 public:
  Picker(const RingSorted& sorted, const Curvature& curvature, const RegistrationConfig& config)
      : s_(sorted),
        v_(curvature),
        c_(config),
        min_bend_(std::tan(0.5 * config.edge_min_bend_deg * std::numbers::pi / 180.0)),
        labels_(sorted.points.size(), kNone),
        taken_(sorted.points.size(), 0),
        flatness_(curvature.chi2) {
    for (std::size_t i = 0; i < flatness_.size(); ++i) {
      if (v_.kind[i] != Kind::kPlain) flatness_[i] = kNever;
    }
  }

  void run() {
    const auto segments = static_cast<std::uint32_t>(std::max(1, c_.segments));
    for (std::size_t ring = 0; ring + 1 < s_.ring_begin.size(); ++ring) {
      begin_ = s_.ring_begin[ring];
      end_ = s_.ring_begin[ring + 1];
      const std::uint64_t n = end_ - begin_;
      for (std::uint32_t k = 0; k < segments; ++k) {
        const auto first = begin_ + static_cast<std::uint32_t>(n * k / segments);
        const auto last = begin_ + static_cast<std::uint32_t>(n * (k + 1) / segments);
        pick_edges(first, last);
        pick_flats(first, last);
      }
    }
  }

  const std::vector<std::uint8_t>& labels() const { return labels_; }
  std::uint32_t edge_candidates() const { return edge_candidates_; }

 private:
  struct Candidate {
    float key;  // the greatest is picked first
    std::uint32_t index;
    bool operator<(const Candidate& o) const {
      return key != o.key ? key < o.key : index > o.index;
    }
  };

  bool is_edge(std::uint32_t i) const {
    return v_.kind[i] == Kind::kSilhouette ||
           (v_.kind[i] == Kind::kPlain && v_.chi2[i] > c_.edge_chi2 && v_.bend[i] > min_bend_);
  }

  // Picks the points of greatest chi2 that no earlier pick suppresses.
  void pick_edges(std::uint32_t first, std::uint32_t last) {
    heap_.clear();
    for (std::uint32_t i = first; i < last; ++i) {
      if (is_edge(i)) {
        heap_.push_back({v_.chi2[i], i});
      }
    }
    edge_candidates_ += static_cast<std::uint32_t>(heap_.size());
    std::make_heap(heap_.begin(), heap_.end());
    for (int picked = 0; picked < c_.less_sharp_per_segment && !heap_.empty();) {
      std::pop_heap(heap_.begin(), heap_.end());
      const std::uint32_t i = heap_.back().index;
      heap_.pop_back();
      if (taken_[i] != 0) continue;
      suppress_around(i);
      labels_[i] = kLessSharp | (picked < c_.sharp_per_segment ? kSharp : kNone);
      ++picked;
    }
  }

  // Nearly all points are candidates and few are picked, so each pick searches the segment instead
  // of sorting it.
  void pick_flats(std::uint32_t first, std::uint32_t last) {
    const std::span<const float> segment(flatness_.data() + first, last - first);
    for (int picked = 0; picked < c_.flat_per_segment; ++picked) {
      const float least = least_of(segment);
      if (!(least < static_cast<float>(c_.flat_chi2))) return;
      const auto at = std::find(segment.begin(), segment.end(), least) - segment.begin();
      const std::uint32_t flattest = first + static_cast<std::uint32_t>(at);
      suppress_around(flattest);
      labels_[flattest] = kFlat;
    }
  }

  static float least_of(std::span<const float> values) {
    Float4 least = {kNever, kNever, kNever, kNever};
    std::size_t i = 0;
    for (; i + 4 <= values.size(); i += 4) {
      Float4 four;
      std::memcpy(&four, &values[i], sizeof four);
      least = four < least ? four : least;
    }
    float found = std::min(std::min(least[0], least[1]), std::min(least[2], least[3]));
    for (; i < values.size(); ++i) found = values[i] < found ? values[i] : found;
    return found;
  }

  void take(std::uint32_t i) {
    taken_[i] = 1;
    flatness_[i] = kNever;
  }

  void suppress_around(std::uint32_t i) {
    take(i);
    for (std::uint32_t j = i, n = 0; n < std::uint32_t(c_.suppression) && v_.break_after[j] == 0;
         ++n) {
      take(++j);
    }
    for (std::uint32_t j = i, n = 0;
         n < std::uint32_t(c_.suppression) && j > begin_ && v_.break_after[j - 1] == 0; ++n) {
      take(--j);
    }
  }

  const RingSorted& s_;
  const Curvature& v_;
  const RegistrationConfig& c_;
  double min_bend_;
  std::vector<std::uint8_t> labels_;
  std::vector<std::uint8_t> taken_;
  // chi2 of the points that can be picked as flat, kNever for all others
  std::vector<float> flatness_;
  std::vector<Candidate> heap_;
  std::uint32_t begin_ = 0;
  std::uint32_t end_ = 0;
  std::uint32_t edge_candidates_ = 0;
};

// Voxel filter along one ring: averages successive points in the same voxel. The points of a ring
// are in order, so no search is needed; a voxel that the ring leaves and re-enters gives two
// points.
class RingVoxelFilter {
 public:
  RingVoxelFilter(double leaf_m, PointVector& out) : per_leaf_(1.0 / leaf_m), out_(out) {}

  void add(const Point& p) {
    const Eigen::Vector3i cell =
        (p.position().cast<double>() * per_leaf_).array().floor().cast<int>().matrix();
    if (count_ > 0 && (cell != cell_ || p.ring != last_.ring)) {
      flush();
    }
    cell_ = cell;
    last_ = p;
    sum_ += Eigen::Vector4d(p.x, p.y, p.z, p.intensity);
    time_sum_ns_ += p.time_ns;
    ++count_;
  }

  void flush() {
    if (count_ == 0) {
      return;
    }
    const Eigen::Vector4f mean = (sum_ / double(count_)).cast<float>();
    last_.x = mean.x();
    last_.y = mean.y();
    last_.z = mean.z();
    last_.intensity = mean.w();
    last_.time_ns = static_cast<std::uint32_t>(time_sum_ns_ / count_);
    out_.push_back(last_);
    sum_.setZero();
    time_sum_ns_ = 0;
    count_ = 0;
  }

 private:
  double per_leaf_;
  PointVector& out_;
  Eigen::Vector3i cell_ = Eigen::Vector3i::Zero();
  Point last_{};
  Eigen::Vector4d sum_ = Eigen::Vector4d::Zero();
  std::uint64_t time_sum_ns_ = 0;
  std::uint64_t count_ = 0;
};

void collect_less_flat(const RingSorted& sorted, const std::vector<std::uint8_t>& keep,
                       double leaf_m, PointVector& out) {
  out.reserve(sorted.points.size());
  if (leaf_m <= 0.0) {
    for (std::size_t i = 0; i < sorted.points.size(); ++i) {
      if (keep[i] != 0) {
        out.push_back(sorted.points[i]);
      }
    }
    return;
  }
  RingVoxelFilter filter(leaf_m, out);
  for (std::size_t i = 0; i < sorted.points.size(); ++i) {
    if (keep[i] != 0) {
      filter.add(sorted.points[i]);
    }
  }
  filter.flush();
}

void collect(const RingSorted& sorted, const Curvature& curvature,
             const std::vector<std::uint8_t>& labels, const RegistrationConfig& config,
             RegistrationResult& result) {
  std::vector<std::uint8_t> keep(sorted.points.size(), 0);
  for (std::size_t i = 0; i < sorted.points.size(); ++i) {
    const Point& p = sorted.points[i];
    if ((labels[i] & kSharp) != 0) {
      result.sharp.push_back(p);
    }
    if ((labels[i] & kLessSharp) != 0) {
      result.less_sharp.push_back(p);
      continue;
    }
    if ((labels[i] & kFlat) != 0) {
      result.flat.push_back(p);
    }
    keep[i] = 1;
    if (is_unreliable(curvature.kind[i])) {
      const RejectReason reason = curvature.kind[i] == Kind::kParallel ? RejectReason::kNearParallel
                                                                       : RejectReason::kOccluded;
      ++result.diagnostics.rejected[static_cast<std::size_t>(reason)];
      if (config.drop_unreliable) {
        keep[i] = 0;
        result.rejected.push_back(p);
        result.reasons.push_back(reason);
      }
    }
  }
  collect_less_flat(sorted, keep, config.less_flat_leaf_m, result.less_flat);
}

// Standard deviation of the range noise, from the smooth points: 1.4826 * median of the absolute
// values, of a sample large enough for an error of 1 %.
double measured_noise(std::vector<float>& components) {
  constexpr std::size_t kEnough = 20000;
  if (components.size() < 100) {
    return 0.0;
  }
  const std::size_t stride = stride_to(kEnough, components.size());
  for (std::size_t i = 0; i < components.size(); i += stride) {
    components[i / stride] = std::abs(components[i]);
  }
  components.resize((components.size() + stride - 1) / stride);
  const auto middle = components.begin() + static_cast<std::ptrdiff_t>(components.size() / 2);
  std::nth_element(components.begin(), middle, components.end());
  return 1.4826 * *middle;
}

Health health_of(std::size_t points_used, const RegistrationConfig& config) {
  if (points_used == 0) return Health::kEmpty;
  const auto enough = static_cast<std::size_t>(std::max(0, config.min_points));
  return points_used < enough ? Health::kTooFewPoints : Health::kOk;
}

}  // namespace

RegistrationResult extract_features(PointSpan sweep, const SweepInfo& info,
                                    const RegistrationConfig& config) {
  RegistrationResult result;
  result.diagnostics.points_in = static_cast<std::uint32_t>(sweep.size());
  const RingSorted sorted = sort_by_ring(sweep, info, config, result);
  result.diagnostics.points_used = static_cast<std::uint32_t>(sorted.points.size());
  result.diagnostics.step_rad = sorted.step_rad;
  result.health = health_of(sorted.points.size(), config);
  if (sorted.points.empty()) return result;
  if (info.rings == 0) {
    const std::vector<std::uint8_t> all(sorted.points.size(), 1);
    collect_less_flat(sorted, all, config.less_flat_leaf_m, result.less_flat);
    return result;
  }
  Curvature curvature = compute_curvature(sorted, config);
  Picker picker(sorted, curvature, config);
  picker.run();
  collect(sorted, curvature, picker.labels(), config, result);
  result.diagnostics.edge_candidates = picker.edge_candidates();
  result.diagnostics.measured_noise_m = measured_noise(curvature.beam_component_m);
  return result;
}

}  // namespace zloam::registration
