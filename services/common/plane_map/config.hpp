#pragma once
// Settings of the voxel plane map and of matching sweeps to it. Lengths in metres, angles in
// rad; "sigmas" are multiples of the range noise.

#include <Eigen/Core>
#include <cstddef>

namespace zloam::plane_map {

struct PlaneMapConfig {
  /// Edge of the coarsest voxels; each level halves it: 2, 1, 0.5, 0.25, 0.125 m. levels in [2, 6].
  double root_voxel_m = 2.0;
  int levels = 5;

  /// Standard deviation of one range measurement.
  double range_noise_m = 0.02;

  /// A voxel is a plane when it has min_points, with eigenvalues l0 <= l1 <= l2 of the points'
  /// covariance: sqrt(l0) < thickness * noise, sqrt(l1) > width * noise (a single ring thickened by
  /// noise is no plane), l1 > aspect * l0, and sqrt(l0 / (n * l1)), the normal's error, below
  /// normal_error.
  unsigned min_points = 8;
  double thickness_sigmas = 2.0;
  double width_sigmas = 3.0;
  double aspect = 9.0;
  double normal_error_rad = 0.05;

  /// A finest voxel that is no plane by itself is fitted again with those of its 26 neighbours
  /// whose centroid lies within merge_radius_voxels of its own. 0 switches merging off.
  double merge_radius_voxels = 1.3;
  double merged_thickness_sigmas = 1.2;
  double merged_width_sigmas = 2.1;

  /// A voxel is a plane only when it holds points of several rings. Where one ring bends around an
  /// edge it spans a false plane that follows the sensor and holds it back; a standing sensor
  /// creates many of them.
  bool planes_several_rings = true;
  /// A plane is also rejected if a single ring is known to have given more than this share of its
  /// points (above (1 + share) / 2 it is always known), as a line and a few points beside it lie in
  /// a plane; unless it is thinner than the trace of a beam that faces it could be.
  double one_ring_lead = 0.75;
  double one_ring_thickness_sigmas = 0.6;

  /// The grid is rotated and shifted against the map's axes: floors and walls at a multiple of the
  /// voxel size would be split into two half-noise planes that agree with any small shift.
  Eigen::Vector3d grid_rotation_rad{0.1, 0.15, 0.5};
  Eigen::Vector3d grid_shift_m{0.137, 0.291, 0.173};

  /// A voxel is fitted again when its points grew by this factor since its last fit.
  double refit_growth = 1.1;

  /// A plane with this many points drops its finer voxels and creates no more of them, as look-up
  /// goes from coarse to fine and stops at the first plane.
  unsigned settled_points = 1000;

  /// So does a plane of this many points once the sensor is farther away than settled_radius_m:
  /// most of the map lies behind the sensor, and its finer voxels are most of the memory.
  unsigned settled_far_points = 100;
  double settled_radius_m = 40.0;

  /// Finest voxels where no plane fits count as distributions (lines and blobs). They cost a little
  /// accuracy where planes abound, and keep the axis of a smooth tunnel.
  bool distributions = true;
  /// ... but only those with points of several rings. One ring's trace over a smooth wall is a line
  /// that follows the sensor and holds it back.
  bool distributions_several_rings = true;

  /// A coarser voxel that holds a post, and nothing else, serves as a line for those of its finest
  /// voxels that have no fit: at ten metres each of these is hit by one ring alone. A post is no
  /// wider than this (one sigma of its points), post_aspect times as long as wide (sigmas), seen by
  /// rings of which none gave more than (1 + post_lead) / 2 of its points, and inside the voxel
  /// with post_margin_sigmas of its width on either side. 0: none.
  double post_width_m = 0.15;
  double post_aspect = 3.0;
  double post_lead = 0.34;
  double post_margin_sigmas = 5.0;

  /// Voxels farther than this from the sensor are dropped.
  double keep_radius_m = 150.0;
};

struct MatcherConfig {
  /// Every stride-th point is matched, and all are counted in the map; a denser sweep is thinned to
  /// every n-th point, with n such that at least enough_points (enough_inserted_points) remain. The
  /// choice changes from sweep to sweep.
  unsigned stride = 2;
  std::size_t enough_points = 10000;
  std::size_t enough_inserted_points = 20000;
  double min_range_m = 0.5;

  int max_iterations = 25;
  double stop_rotation_rad = 5e-5;
  double stop_translation_m = 5e-4;

  /// Errors of points on one surface are correlated: information is divided by this.
  double correlation = 5.0;
  /// Errors of surfaces close together are correlated, too, and moving objects move as a whole: two
  /// vans at a fixed distance have more points than all else that constrains the pose in a street.
  /// Each of n points on surfaces facing one way in a root voxel counts 1 / (1 + n / crowd_points).
  /// 0: fully.
  double crowd_points = 20.0;

  /// Residuals above the gate are rejected; the gate follows the error of the prediction at
  /// gate_range_m between these limits. Kernel width (Geman-McClure) = gate / 3. This is the gate
  /// of the first iteration.
  double min_gate_m = 0.3;
  double max_gate_m = 1.0;
  double gate_range_m = 10.0;
  /// After the first iteration residuals are rejected above fine_gate_m, with a kernel of
  /// fine_kernel_m: otherwise a wall's other side, 0.2 m behind the mapped one, and moved objects
  /// would pull the pose. Both are multiplied by fine_least_share / share where the normals' share
  /// along the least constrained direction is lower, as in a tunnel: the few constraints may be
  /// farther off. share: mean of the last sweeps, or of this one if there are none.
  double fine_gate_m = 0.15;
  double fine_kernel_m = 0.066;
  double fine_least_share = 0.03;

  /// Motion from sweep to sweep: random change of the motion over one sweep, and an additional
  /// difference between the poses at two mid-sweeps and the mean of both motions: larger, by this
  /// share, when the last two motions differ.
  double change_sigma_m = 0.03;
  double change_sigma_rad = 0.02;
  double continuity_sigma_m = 0.0003;
  double continuity_sigma_rad = 0.0002;
  double continuity_share = 0.03;
  /// Upper limit of the last pose's own covariance: however poorly it was constrained, the map
  /// around it was built from it.
  double pose_sigma_m = 0.010;
  double pose_sigma_rad = 0.002;

  /// With fewer matched points than this the sweep is only predicted and not inserted.
  std::size_t min_matches = 30;

  /// Errors of the map's normals (corners in a voxel, noise) make an open direction look
  /// constrained: their variance, at least that of normal_error_rad, is subtracted first.
  double normal_error_rad = 0.035;
  /// Between walls (the next weakest direction has at least this mean squared share of the normals)
  /// a plane counts along a degenerate direction only if its normal's cosine with it is at least
  /// weak_least_cosine: the information of others is the error of their normals. On open ground,
  /// slopes are the only information.
  double walls_least_share = 0.05;
  double weak_least_cosine = 0.07;
};

}  // namespace zloam::plane_map
