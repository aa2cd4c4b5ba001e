#pragma once
// Configuration of the registration stage. Every default is written here and nowhere else.

#include <cstdint>

namespace zloam::registration {

/// Which returns of a firing with two returns are used.
enum class ReturnSelection : std::uint8_t { kStrongest = 0, kLast = 1, kAll = 2 };

struct RegistrationConfig {
  /// Points outside [min_range_m, max_range_m] are dropped.
  double min_range_m = 0.5;
  double max_range_m = 130.0;
  ReturnSelection returns = ReturnSelection::kStrongest;
  /// One standard deviation of a range, m (sensor's data sheet).
  double range_noise_m = 0.02;

  /// Neighbours on either side for the curvature. LOAM and A-LOAM: 5. On near surfaces more points
  /// are needed to detect a bend above the noise, so the window grows to about window_width_m, up
  /// to half_window_max.
  int half_window_min = 5;
  int half_window_max = 15;
  double window_width_m = 0.4;

  /// Quotas of a ring (LOAM, section V-A, and A-LOAM, scanRegistration.cpp).
  int segments = 6;
  int sharp_per_segment = 2;
  int less_sharp_per_segment = 20;
  int flat_per_segment = 4;
  /// Neighbours on either side of a picked point that can't be picked.
  int suppression = 5;

  /// A bend counts as an edge when its squared curvature exceeds edge_chi2 times its variance (5
  /// sigma: one false edge in about 60 sweeps of 29 000 points), and when the two sides meet at
  /// more than edge_min_bend_deg.
  double edge_chi2 = 25.0;
  double edge_min_bend_deg = 25.0;
  /// Flat points must stay below this many variances.
  double flat_chi2 = 4.0;

  /// Depth step between adjacent firings that counts as the edge of an occlusion, m. LOAM as
  /// released: squared distance above 0.1 m^2.
  double gap_min_m = 0.32;
  /// Points rejected on the far side of an occlusion edge (LOAM as released: 6).
  int occluded_points = 6;
  /// A surface steeper than this against the beam's normal (tangent of the incidence angle) counts
  /// as parallel to the beam. LOAM as released: neighbours' squared distance above 0.0002 r^2 on
  /// both sides, which is a tangent of 4 at steps of 0.2 degrees.
  double parallel_tangent = 4.0;
  /// True: points rejected as parallel or occluded are dropped from less_flat as well. LOAM as
  /// released keeps them there (they are real surface, only no good edges).
  bool drop_unreliable = false;

  /// Voxel edge of the filter over less_flat, m, applied to each ring; 0 keeps every point.
  double less_flat_leaf_m = 0.0;
  /// Fewer valid points than this make the sweep unhealthy.
  int min_points = 100;
};

}  // namespace zloam::registration
