#include "registration/curvature.hpp"

#include <algorithm>
#include <cmath>

#include "common/geometry/lanes.hpp"

namespace zloam::registration {
namespace {

// With fewer points than this, the near side of an occlusion edge may be a stray return.
constexpr std::uint32_t kMinSilhouetteRun = 3;
// A step must exceed the noise of the difference of two ranges by this many standard deviations.
constexpr double kStepSigmas = 3.0;
// A surface is bridged across at most this many firing steps, that is, three missing returns.
constexpr double kBridgedSteps = 4.6;
// Lower bound for the squared sine of the angle between beam and surface: below it, the range noise
// moves points along the surface.
constexpr double kMinSine2 = 0.05;

class RingPass {
 public:
  RingPass(const RingSorted& sorted, const RegistrationConfig& config, Curvature& out)
      : s_(sorted),
        c_(config),
        out_(out),
        step_noise_m_(kStepSigmas * std::sqrt(2.0) * config.range_noise_m),
        noise2_(std::max(1e-12, config.range_noise_m * config.range_noise_m)) {
    for (int k = 0; k <= std::max(config.half_window_min, config.half_window_max); ++k) {
      gain_.push_back(2.0 * k + 4.0 * k * k);
      root_gain_.push_back(std::sqrt(gain_.back()));
    }
  }

  void run(std::uint32_t begin, std::uint32_t end) {
    if (begin == end) {
      return;
    }
    begin_ = begin;
    end_ = end;
    find_breaks();
    sum_prefixes();
    std::uint32_t first = begin;
    for (std::uint32_t i = begin; i < end; ++i) {
      if (out_.break_after[i] != 0) {
        smooth_run(first, i + 1);
        first = i + 1;
      }
    }
    mark_parallel();
    mark_occlusions();
  }

 private:
  // Range step between firings on a surface at the steepest incidence that is accepted.
  double steepest_step_m(double range_m) const {
    return c_.parallel_tangent * s_.step_rad * range_m;
  }

  // A few missing returns are no break if the depth on both sides fits one surface: they occur
  // within any wall (one in a hundred of a VLP-16's returns, dark spots, panes), and each such
  // break would make two false edges.
  void find_breaks() {
    for (std::uint32_t i = begin_; i < end_; ++i) {
      if (i + 1 == end_) {
        out_.break_after[i] = 1;
        continue;
      }
      const double steps = adjacent(s_, i) ? 1.0 : steps_after(s_, i);
      const double near_m = std::min(s_.range_m[i], s_.range_m[i + 1]);
      const double step_m = std::abs(s_.range_m[i + 1] - s_.range_m[i]);
      const double deepest_m = std::max(c_.gap_min_m, steps * steepest_step_m(near_m));
      out_.break_after[i] = steps > kBridgedSteps || step_m > deepest_m + step_noise_m_ ? 1 : 0;
    }
  }

  void sum_prefixes() {
    prefix_.resize(end_ - begin_ + 1);
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    prefix_[0] = sum;
    for (std::uint32_t i = begin_; i < end_; ++i) {
      sum += s_.points[i].position().cast<double>();
      prefix_[i - begin_ + 1] = sum;
    }
  }

  Eigen::Vector3d sum(std::uint32_t from, std::uint32_t to) const {
    return prefix_[to - begin_] - prefix_[from - begin_];
  }

  // Half the window at point i, so that it spans about window_width_m.
  std::uint32_t half_window(std::uint32_t i) const {
    const double spacing_m = std::max(1e-6, s_.step_rad * s_.range_m[i]);
    const double k = 0.5 * c_.window_width_m / spacing_m;
    return static_cast<std::uint32_t>(
        std::clamp(k, double(c_.half_window_min), double(c_.half_window_max)));
  }

  // Computes the curvature of the points of one unbroken stretch [first, last).
  void smooth_run(std::uint32_t first, std::uint32_t last) {
    for (std::uint32_t i = first; i < last; ++i) {
      const std::uint32_t room = std::min(i - first, last - 1 - i);
      const std::uint32_t k = std::min(half_window(i), room);
      if (k < static_cast<std::uint32_t>(c_.half_window_min)) {
        out_.kind[i] = Kind::kUnknown;
      } else {
        measure(i, k);
      }
    }
  }

  // Divisions dominate the time: each quotient is computed once, and two at a time.
  void measure(std::uint32_t i, std::uint32_t k) {
    const Eigen::Vector3d p = s_.points[i].position().cast<double>();
    const Eigen::Vector3d left = sum(i - k, i);
    const Eigen::Vector3d right = sum(i + 1, i + k + 1);
    const Eigen::Vector3d d = left + right - 2.0 * k * p;
    const Eigen::Vector3d chord = right - left;
    const Double2 inverse =
        1.0 / Double2{std::max(chord.squaredNorm(), 1e-12), double(s_.range_m[i])};
    const double per_chord2 = inverse[0];
    const double per_range = inverse[1];
    const double along = d.dot(chord);
    const double across2 = std::max(0.0, d.squaredNorm() - along * along * per_chord2);
    const double cosine = p.dot(chord) * per_range;
    const double sine2 = std::max(kMinSine2, 1.0 - cosine * cosine * per_chord2);
    const Double2 in_noises =
        Double2{across2, d.dot(p) * per_range} / Double2{gain_[k] * noise2_ * sine2, root_gain_[k]};
    out_.kind[i] = Kind::kPlain;
    out_.chi2[i] = static_cast<float>(in_noises[0]);
    out_.bend[i] = static_cast<float>(std::sqrt(across2 * per_chord2));
    if (sine2 > 0.5) {
      out_.beam_component_m.push_back(static_cast<float>(in_noises[1]));
    }
  }

  // LOAM, section V-A, figure 4a: a patch roughly parallel to the beam.
  void mark_parallel() {
    for (std::uint32_t i = begin_ + 1; i + 1 < end_; ++i) {
      const double limit_m = steepest_step_m(s_.range_m[i]) + step_noise_m_;
      const double before_m = std::abs(s_.range_m[i] - s_.range_m[i - 1]);
      const double after_m = std::abs(s_.range_m[i + 1] - s_.range_m[i]);
      if (before_m > limit_m && after_m > limit_m && adjacent(s_, i - 1) && adjacent(s_, i)) {
        out_.kind[i] = Kind::kParallel;
      }
    }
  }

  // LOAM, section V-A, figure 4b: the far side of a step may continue behind the near side, so its
  // end is no edge; the end of the near side is one. A missing return counts as far away.
  void mark_occlusions() {
    for (std::uint32_t i = begin_; i + 1 < end_; ++i) {
      if (out_.break_after[i] == 0) {
        continue;
      }
      if (!adjacent(s_, i)) {
        mark_silhouette(i, false, c_.gap_min_m);
        mark_silhouette(i + 1, true, c_.gap_min_m);
        continue;
      }
      const double step_m = s_.range_m[i + 1] - s_.range_m[i];
      if (step_m > 0.0) {
        mark_occluded(i + 1, true);
        mark_silhouette(i, false, step_m);
      } else {
        mark_occluded(i, false);
        mark_silhouette(i + 1, true, -step_m);
      }
    }
  }

  void mark_occluded(std::uint32_t i, bool forward) {
    for (int n = 0; n < c_.occluded_points; ++n) {
      out_.kind[i] = Kind::kOccluded;
      if (forward ? out_.break_after[i] != 0 : (i == begin_ || out_.break_after[i - 1] != 0)) {
        return;
      }
      i = forward ? i + 1 : i - 1;
    }
  }

  // Point i is the end of a surface; forward: the surface extends to higher indices.
  void mark_silhouette(std::uint32_t i, bool forward, double step_m) {
    std::uint32_t run = 1;
    for (std::uint32_t j = i; run < static_cast<std::uint32_t>(c_.half_window_min); ++run) {
      if (forward ? out_.break_after[j] != 0 : (j == begin_ || out_.break_after[j - 1] != 0)) {
        break;
      }
      j = forward ? j + 1 : j - 1;
    }
    if (run < kMinSilhouetteRun || out_.kind[i] == Kind::kParallel ||
        out_.kind[i] == Kind::kOccluded) {
      return;
    }
    const double k = c_.half_window_min;
    const double gain = (2.0 * k + 4.0 * k * k) * c_.range_noise_m * c_.range_noise_m;
    const double d = k * step_m;
    out_.kind[i] = Kind::kSilhouette;
    out_.chi2[i] = static_cast<float>(d * d / std::max(1e-12, gain));
    out_.bend[i] = 1.0F;
  }

  const RingSorted& s_;
  const RegistrationConfig& c_;
  Curvature& out_;
  double step_noise_m_;
  double noise2_;
  // By half window k: variance of d and its root, in units of the range noise.
  std::vector<double> gain_, root_gain_;
  std::vector<Eigen::Vector3d> prefix_;
  std::uint32_t begin_ = 0;
  std::uint32_t end_ = 0;
};

}  // namespace

Curvature compute_curvature(const RingSorted& sorted, const RegistrationConfig& config) {
  const std::size_t n = sorted.points.size();
  Curvature out;
  out.kind.assign(n, Kind::kUnknown);
  out.chi2.assign(n, 0.0F);
  out.bend.assign(n, 0.0F);
  out.break_after.assign(n, 0);
  out.beam_component_m.reserve(n);
  RingPass pass(sorted, config, out);
  for (std::size_t ring = 0; ring + 1 < sorted.ring_begin.size(); ++ring) {
    pass.run(sorted.ring_begin[ring], sorted.ring_begin[ring + 1]);
  }
  return out;
}

}  // namespace zloam::registration
