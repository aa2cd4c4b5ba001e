#include "settings.hpp"

#include <map>
#include <sstream>
#include <stdexcept>
#include <type_traits>
#include <variant>

namespace zloam::offline {
namespace {

using Field =
    std::variant<double*, int*, std::uint32_t*, std::size_t*, bool*, std::string*, std::uint8_t*>;
using Fields = std::map<std::string, Field>;

template <typename Enum>
std::uint8_t* number_of(Enum& value) {
  static_assert(sizeof(Enum) == 1);
  return reinterpret_cast<std::uint8_t*>(&value);
}

// A member's name cannot be in parentheses. NOLINTNEXTLINE(bugprone-macro-parentheses)
#define ZLOAM_FIELD(prefix, object, name) fields[prefix #name] = &(object).name

void add_registration(registration::RegistrationConfig& c, Fields& fields) {
  fields["registration.returns"] = number_of(c.returns);
  ZLOAM_FIELD("registration.", c, min_range_m);
  ZLOAM_FIELD("registration.", c, max_range_m);
  ZLOAM_FIELD("registration.", c, range_noise_m);
  ZLOAM_FIELD("registration.", c, half_window_min);
  ZLOAM_FIELD("registration.", c, half_window_max);
  ZLOAM_FIELD("registration.", c, window_width_m);
  ZLOAM_FIELD("registration.", c, segments);
  ZLOAM_FIELD("registration.", c, sharp_per_segment);
  ZLOAM_FIELD("registration.", c, less_sharp_per_segment);
  ZLOAM_FIELD("registration.", c, flat_per_segment);
  ZLOAM_FIELD("registration.", c, suppression);
  ZLOAM_FIELD("registration.", c, edge_chi2);
  ZLOAM_FIELD("registration.", c, edge_min_bend_deg);
  ZLOAM_FIELD("registration.", c, flat_chi2);
  ZLOAM_FIELD("registration.", c, gap_min_m);
  ZLOAM_FIELD("registration.", c, occluded_points);
  ZLOAM_FIELD("registration.", c, parallel_tangent);
  ZLOAM_FIELD("registration.", c, drop_unreliable);
  ZLOAM_FIELD("registration.", c, less_flat_leaf_m);
}

void add_odometry(odometry::OdometryConfig& c, Fields& fields) {
  ZLOAM_FIELD("odometry.", c, max_iterations);
  ZLOAM_FIELD("odometry.", c, stop_translation_m);
  ZLOAM_FIELD("odometry.", c, stop_rotation_rad);
  ZLOAM_FIELD("odometry.", c, min_correspondences);
  ZLOAM_FIELD("odometry.", c, kernel_m);
  ZLOAM_FIELD("odometry.", c, kernel_start_m);
  ZLOAM_FIELD("odometry.", c, correlation);
  ZLOAM_FIELD("odometry.", c, begin_sigma_m);
  ZLOAM_FIELD("odometry.", c, begin_sigma_rad);
  ZLOAM_FIELD("odometry.", c, pose_sigma_m);
  ZLOAM_FIELD("odometry.", c, pose_sigma_rad);
  ZLOAM_FIELD("odometry.", c, continuity_sigma_m);
  ZLOAM_FIELD("odometry.", c, continuity_sigma_rad);
  ZLOAM_FIELD("odometry.", c, continuity_share);
  ZLOAM_FIELD("odometry.", c, acceleration_sigma_mps2);
  ZLOAM_FIELD("odometry.", c, angular_acceleration_sigma_radps2);
  ZLOAM_FIELD("odometry.", c, initial_speed_sigma_mps);
  ZLOAM_FIELD("odometry.", c, initial_rate_sigma_radps);
  ZLOAM_FIELD("odometry.", c, use_imu);
  ZLOAM_FIELD("odometry.", c, imu_force_noise);
  ZLOAM_FIELD("odometry.", c, imu_rate_noise);
  ZLOAM_FIELD("odometry.", c, slice_acceleration_sigma_mps2);
  ZLOAM_FIELD("odometry.", c, slice_angular_acceleration_sigma_radps2);
  ZLOAM_FIELD("odometry.", c, slice_force_sigma_mps2);
  ZLOAM_FIELD("odometry.", c, imu_force_error_mps2);
  ZLOAM_FIELD("odometry.", c, imu_scale_error);
  ZLOAM_FIELD("odometry.", c, imu_force_bias_mps2);
  ZLOAM_FIELD("odometry.", c, imu_rate_bias_radps);
  ZLOAM_FIELD("odometry.", c, imu_force_walk);
  ZLOAM_FIELD("odometry.", c, imu_rate_walk);
  ZLOAM_FIELD("odometry.", c, imu_gravity_walk);
  ZLOAM_FIELD("odometry.", c, imu_delay_sigma_ms);
  ZLOAM_FIELD("odometry.", c, imu_delay_walk_ms);
  ZLOAM_FIELD("odometry.", c, imu_normal_error_rad);
  ZLOAM_FIELD("odometry.", c, imu_rest_acceleration_mps2);
  ZLOAM_FIELD("odometry.", c, imu_start_acceleration_mps2);
  ZLOAM_FIELD("odometry.", c, window_sweeps);
  ZLOAM_FIELD("odometry.", c, voxel_m);
  ZLOAM_FIELD("odometry.", c, voxel_levels);
  ZLOAM_FIELD("odometry.", c, max_matched_points);
  ZLOAM_FIELD("odometry.", c, enough_inserted_points);
  ZLOAM_FIELD("odometry.", c, plane_min_points);
  ZLOAM_FIELD("odometry.", c, plane_thickness_sigmas);
  ZLOAM_FIELD("odometry.", c, max_turn_radps);
  ZLOAM_FIELD("odometry.", c, plane_width_sigmas);
  ZLOAM_FIELD("odometry.", c, plane_normal_error_rad);
  ZLOAM_FIELD("odometry.", c, drift_limit);
  ZLOAM_FIELD("odometry.", c, covariance_scale);
}

void add_plane_map(plane_map::PlaneMapConfig& c, Fields& fields) {
  ZLOAM_FIELD("mapping.voxel_planes.", c, root_voxel_m);
  ZLOAM_FIELD("mapping.voxel_planes.", c, levels);
  ZLOAM_FIELD("mapping.voxel_planes.", c, min_points);
  ZLOAM_FIELD("mapping.voxel_planes.", c, thickness_sigmas);
  ZLOAM_FIELD("mapping.voxel_planes.", c, width_sigmas);
  ZLOAM_FIELD("mapping.voxel_planes.", c, normal_error_rad);
  ZLOAM_FIELD("mapping.voxel_planes.", c, merge_radius_voxels);
  ZLOAM_FIELD("mapping.voxel_planes.", c, refit_growth);
  ZLOAM_FIELD("mapping.voxel_planes.", c, settled_points);
  ZLOAM_FIELD("mapping.voxel_planes.", c, settled_far_points);
  ZLOAM_FIELD("mapping.voxel_planes.", c, settled_radius_m);
  ZLOAM_FIELD("mapping.voxel_planes.", c, planes_several_rings);
  ZLOAM_FIELD("mapping.voxel_planes.", c, one_ring_lead);
  ZLOAM_FIELD("mapping.voxel_planes.", c, one_ring_thickness_sigmas);
  ZLOAM_FIELD("mapping.voxel_planes.", c, distributions);
  ZLOAM_FIELD("mapping.voxel_planes.", c, distributions_several_rings);
  ZLOAM_FIELD("mapping.voxel_planes.", c, post_width_m);
  ZLOAM_FIELD("mapping.voxel_planes.", c, post_aspect);
  ZLOAM_FIELD("mapping.voxel_planes.", c, post_lead);
  ZLOAM_FIELD("mapping.voxel_planes.", c, post_margin_sigmas);
  ZLOAM_FIELD("mapping.voxel_planes.", c, keep_radius_m);
}

void add_plane_matcher(plane_map::MatcherConfig& c, Fields& fields) {
  ZLOAM_FIELD("mapping.voxel_planes.", c, stride);
  ZLOAM_FIELD("mapping.voxel_planes.", c, enough_points);
  ZLOAM_FIELD("mapping.voxel_planes.", c, enough_inserted_points);
  ZLOAM_FIELD("mapping.voxel_planes.", c, max_iterations);
  ZLOAM_FIELD("mapping.voxel_planes.", c, stop_rotation_rad);
  ZLOAM_FIELD("mapping.voxel_planes.", c, stop_translation_m);
  ZLOAM_FIELD("mapping.voxel_planes.", c, correlation);
  ZLOAM_FIELD("mapping.voxel_planes.", c, crowd_points);
  ZLOAM_FIELD("mapping.voxel_planes.", c, min_gate_m);
  ZLOAM_FIELD("mapping.voxel_planes.", c, max_gate_m);
  ZLOAM_FIELD("mapping.voxel_planes.", c, fine_gate_m);
  ZLOAM_FIELD("mapping.voxel_planes.", c, fine_kernel_m);
  ZLOAM_FIELD("mapping.voxel_planes.", c, fine_least_share);
  ZLOAM_FIELD("mapping.voxel_planes.", c, change_sigma_m);
  ZLOAM_FIELD("mapping.voxel_planes.", c, change_sigma_rad);
  ZLOAM_FIELD("mapping.voxel_planes.", c, continuity_sigma_m);
  ZLOAM_FIELD("mapping.voxel_planes.", c, continuity_sigma_rad);
  ZLOAM_FIELD("mapping.voxel_planes.", c, continuity_share);
  ZLOAM_FIELD("mapping.voxel_planes.", c, pose_sigma_m);
  ZLOAM_FIELD("mapping.voxel_planes.", c, pose_sigma_rad);
  ZLOAM_FIELD("mapping.voxel_planes.", c, walls_least_share);
  ZLOAM_FIELD("mapping.voxel_planes.", c, weak_least_cosine);
  fields["mapping.voxel_planes.weak_normal_error_rad"] = &c.normal_error_rad;
}

void add_mapping(mapping::MappingConfig& c, Fields& fields) {
  ZLOAM_FIELD("mapping.", c, leaf_edge_m);
  ZLOAM_FIELD("mapping.", c, leaf_plane_m);
  ZLOAM_FIELD("mapping.", c, drift_limit);
  ZLOAM_FIELD("mapping.", c, prior_sigma_m);
  ZLOAM_FIELD("mapping.", c, prior_sigma_rad);
  ZLOAM_FIELD("mapping.", c, prior_scale);
  ZLOAM_FIELD("mapping.", c, covariance_scale_m);
  ZLOAM_FIELD("mapping.", c, covariance_scale_rad);
  ZLOAM_FIELD("mapping.", c, covariance_normal_error_rad);
  ZLOAM_FIELD("mapping.", c, covariance_map_m);
  ZLOAM_FIELD("mapping.", c, covariance_turn_share);
  ZLOAM_FIELD("mapping.", c, covariance_map_turn_rad);
  ZLOAM_FIELD("mapping.", c, insert_distance_m);
  ZLOAM_FIELD("mapping.", c, insert_rotation_rad);
  ZLOAM_FIELD("mapping.", c, insert_residual_factor);
  ZLOAM_FIELD("mapping.", c, voxel_planes.tile_stride);
  add_plane_map(c.voxel_planes.map, fields);
  add_plane_matcher(c.voxel_planes.matcher, fields);
}

void add_integration(integration::IntegrationConfig& c, Fields& fields) {
  ZLOAM_FIELD("integration.", c, correction_delay);
  ZLOAM_FIELD("integration.", c, step_scale_m);
  ZLOAM_FIELD("integration.", c, step_scale_rad);
}

#undef ZLOAM_FIELD

Fields fields_of(Settings& settings) {
  Fields fields;
  add_registration(settings.registration, fields);
  add_odometry(settings.odometry, fields);
  add_mapping(settings.mapping, fields);
  add_integration(settings.integration, fields);
  return fields;
}

template <typename T>
bool parse(const std::string& text, T& value) {
  std::istringstream in(text);
  if constexpr (std::is_same_v<T, std::uint8_t>) {
    int number = 0;
    const bool ok = static_cast<bool>(in >> number) && number >= 0 && number < 256;
    value = static_cast<std::uint8_t>(number);
    return ok && in.eof();
  } else {
    return static_cast<bool>(in >> value) && (in >> std::ws).eof();
  }
}

}  // namespace

void assign_setting(const std::string& assignment, Settings& settings) {
  const std::size_t equals = assignment.find('=');
  const std::string key = assignment.substr(0, equals);
  Fields fields = fields_of(settings);
  const auto field = fields.find(key);
  if (equals == std::string::npos || field == fields.end()) {
    throw std::invalid_argument("no such setting: " + assignment);
  }
  const std::string text = assignment.substr(equals + 1);
  if (!std::visit([&](auto* value) { return parse(text, *value); }, field->second)) {
    throw std::invalid_argument("not a value: " + assignment);
  }
}

std::string listing(Settings& settings) {
  std::ostringstream out;
  for (const auto& [key, field] : fields_of(settings)) {
    out << key << '=';
    std::visit(
        [&](auto* value) {
          if constexpr (std::is_same_v<decltype(value), std::uint8_t*>) {
            out << int(*value);
          } else {
            out << *value;
          }
        },
        field);
    out << '\n';
  }
  return out.str();
}

}  // namespace zloam::offline
