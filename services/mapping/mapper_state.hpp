#pragma once
// State of a Mapper: the steps of a sweep are in mapper.cpp, restoring another instance's state is
// in mapper_restore.cpp. Not for other folders.

#include <cstdint>
#include <deque>
#include <memory>
#include <optional>
#include <span>
#include <utility>
#include <vector>

#include "mapping/bridging.hpp"
#include "mapping/insertion_policy.hpp"
#include "mapping/mapping.hpp"
#include "mapping/method.hpp"
#include "mapping/relocalizer.hpp"
#include "mapping/tile_map.hpp"

namespace zloam::mapping {

// State after the sweep mapped before.
struct LastPose {
  std::int64_t instant_ns = 0;
  std::uint32_t odom_epoch = 0;
  Pose T_map_base = Pose::Identity();
  Pose T_odom_base = Pose::Identity();
  Vector6 twist_per_s = Vector6::Zero();
  Matrix6 covariance = Matrix6::Zero();

  template <class Bits>
  void each(Bits& bits) {
    bits(instant_ns, odom_epoch, T_map_base, T_odom_base, twist_per_s, covariance);
  }
};

// What the last sweep with points told of its pose: it holds for the poses of slices that follow.
struct LastMatch {
  Health health = Health::kOk;
  Degeneracy degeneracy;
  Pose T_odom_base = Pose::Identity();

  template <class Bits>
  void each(Bits& bits) {
    bits(health, degeneracy.degenerate, degeneracy.weak_translation, degeneracy.weak_rotation,
         degeneracy.sigma_measured, degeneracy.sigma_predicted, degeneracy.share, T_odom_base);
  }
  /// In the axes of a later pose.
  Degeneracy degeneracy_at(const Pose& T_odom_later) const {
    const Eigen::Matrix3d R_later_then = T_odom_later.linear().transpose() * T_odom_base.linear();
    Degeneracy turned = degeneracy;
    turned.weak_translation = R_later_then * degeneracy.weak_translation;
    turned.weak_rotation = R_later_then * degeneracy.weak_rotation;
    return turned;
  }
};

// Motion over about the last half second of matched sweeps, in the map's axes: the last sweep
// before a gap is incomplete, and alone gives a poor estimate.
class Lately {
 public:
  void add(std::int64_t instant_ns, const Pose& T_map_base) {
    poses_.push_back({instant_ns, T_map_base});
    if (poses_.size() > kMost) poses_.pop_front();
    const auto& [first_ns, first] = poses_.front();
    const double time_s = 1e-9 * static_cast<double>(instant_ns - first_ns);
    if (!(time_s > 0.0)) return;
    const Eigen::Matrix3d turned = T_map_base.linear() * first.linear().transpose();
    set((T_map_base.translation() - first.translation()) / time_s, log_so3(turned).z() / time_s);
  }
  /// Starts from the pose and twist of an instance that was killed.
  void begin(const Pose& T_map_base, const Vector6& twist_per_s) {
    poses_.clear();
    const Eigen::Matrix3d R = T_map_base.linear();
    set(R * twist_per_s.head<3>(), (R * twist_per_s.tail<3>()).z());
  }
  const Vector6& in_map_per_s() const { return in_map_per_s_; }
  template <class Bits>
  void each(Bits& bits) {
    bits(poses_, in_map_per_s_);
  }

 private:
  void set(const Eigen::Vector3d& velocity, double turn) {
    in_map_per_s_ << velocity, 0.0, 0.0, turn;
  }
  static constexpr std::size_t kMost = 6;
  std::deque<std::pair<std::int64_t, Pose>> poses_;
  Vector6 in_map_per_s_ = Vector6::Zero();
};

struct Mapper::State {
  State(const MappingConfig& c, std::unique_ptr<MappingMethod> m)
      : config(c), method(std::move(m)), tiles(c), policy(c), submaps(c.submap_m) {}

  Prediction predict(const MappingInput& input);
  Match align(const MappingInput& input, const Prediction& prediction);
  bool is_elsewhere(const MappingInput& input, const Match& match, const Prediction& prediction);
  void judge(const MappingInput& input, const Match& match, MappingResult& result);
  static Match near_odometry(Match match, const Prediction& prediction);
  void search_whole_map();
  void begin_search();
  Match searched(const MappingInput& input, const Prediction& prediction);
  Match searched_everywhere(const MappingInput& input, const Prediction& prediction);
  bool left_map(const MappingInput& input);
  /// The map must not change now.
  bool is_fixed() const {
    return config.mode == MappingMode::kLocalize ||
           (config.mode == MappingMode::kExtend && !found_in_map);
  }
  void insert(const MappingInput& input, const Match& match, MappingResult& result);
  bool goes_on(const MappingInput& input) const;
  MappingResult carry(const MappingInput& input);
  Health carried_health(const MappingInput& input) const;
  void remember(const MappingInput& input, const MappingResult& result);
  Matrix6 predicted_covariance(const MappingInput& input, const Prediction& prediction) const;
  double turn_change_rad(const MappingInput& input) const;
  bool each(StateBits& bits);
  bool take_back(std::span<const std::uint64_t> words);
  void go_on_from(const MappingInput& input);
  void put(const InsertClouds& clouds, const Pose& T_map_base);

  MappingConfig config;
  std::unique_ptr<MappingMethod> method;
  TileMap tiles;
  InsertionPolicy policy;
  SubmapBuilder submaps;
  Pose T_map_odom = Pose::Identity();
  std::vector<PathPose> path;
  std::optional<LastPose> last;
  LastMatch last_match;
  Lately lately;
  bool bridging = false;
  // Searching because the sweep did not fit the map at the odometry's pose.
  bool lost = false;
  FitRecord fits;
  std::uint32_t bridged_sweeps = 0;
  // Time without any observation of the motion since the last sweep that was matched.
  double unseen_s = 0.0;
  Agreement agreement;
  Relocalizer relocalizer;
  // The odometry may not continue from the last pose.
  bool break_expected = false;
  // Pose given by a user (Mapper::place).
  std::optional<Pose> told;
  // Found in the map of an earlier run: only then may it be extended.
  bool found_in_map = true;
  // Sweeps in a row that matched nothing of a fixed map, or turns of slices of any map.
  std::uint32_t unmatched = 0;
  // Matches still required before anything is inserted.
  std::uint32_t settling = 0;
  // State of an earlier instance to continue from.
  std::vector<std::uint64_t> resumed;
};

}  // namespace zloam::mapping
