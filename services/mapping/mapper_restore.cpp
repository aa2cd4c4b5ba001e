// Lets a Mapper continue from another instance: from its tiles and voxels, the sweeps inserted
// since then, and its state beside the map.

#include <utility>

#include "mapping/bridging.hpp"
#include "mapping/mapper_state.hpp"
#include "mapping/pose_covariance.hpp"

namespace zloam::mapping {
namespace {

// Version of the layout of state(): change it when the contents change.
constexpr std::uint64_t kStateLayout = 4;

}  // namespace

// The members left out are empty or unset except during a search, when no state is saved.
bool Mapper::State::each(StateBits& bits) {
  bits(T_map_odom, last, last_match, lately, policy, fits, found_in_map, unmatched);
  return method->each(bits);
}

bool Mapper::State::take_back(std::span<const std::uint64_t> words) {
  if (words.size() < 2 || words[0] != kStateLayout || words[1] != words.size()) return false;
  StateBits bits(words.subspan(2));
  return each(bits) && bits.complete() && last;
}

void Mapper::restore(const SavedMap& saved) {
  reset();
  State& s = *state_;
  for (const Tile& tile : saved.tiles) s.tiles.restore(tile);
  s.method->restore(saved.voxels);
  s.last = LastPose{};
  s.last->instant_ns = saved.instant_ns;
  // Without T_map_odom the odometry's frame is treated as a new one.
  s.last->odom_epoch = saved.T_map_odom ? saved.odom_epoch : ~saved.odom_epoch;
  s.last->T_map_base = saved.T_map_base;
  s.last->twist_per_s = saved.twist_per_s;
  s.lately.begin(saved.T_map_base, saved.twist_per_s);
  s.last->covariance = bridge_covariance(s.config, 0.0);
  s.T_map_odom = saved.T_map_odom.value_or(Pose::Identity());
  s.found_in_map = saved.found;
  s.last->T_odom_base = s.T_map_odom.inverse() * saved.T_map_base;
  s.break_expected = true;
}

void Mapper::insert_again(const MappingInput& input, const Pose& T_map_odom,
                          std::span<const std::uint64_t> state) {
  State& s = *state_;
  MappingResult result;
  result.sweep = input.sweep;
  result.T_map_base = normalised(T_map_odom * input.T_odom_base);
  s.tiles.follow(result.T_map_base.translation());
  s.method->prepare(input, result.T_map_base);
  if (!state.empty() && !s.take_back(state)) s.method->not_found();
  Match there;
  there.ok = true;
  there.T_map_base = result.T_map_base;
  there.covariance = prior_covariance(s.config, input.step_covariance);
  s.put(s.method->insert_again(input, there), there.T_map_base);
  s.tiles.take_changed();
}

std::vector<std::uint64_t> Mapper::state() {
  State& s = *state_;
  if (s.bridging || s.lost || s.settling > 0 || s.break_expected || s.told) return {};
  StateBits bits;
  if (!s.each(bits)) return {};
  std::vector<std::uint64_t> words = bits.take();
  words.insert(words.begin(), {kStateLayout, words.size() + 2});
  return words;
}

void Mapper::resume(std::span<const std::uint64_t> state) {
  state_->resumed.assign(state.begin(), state.end());
}

void Mapper::State::go_on_from(const MappingInput& input) {
  const std::vector<std::uint64_t> words = std::exchange(resumed, {});
  if (words.empty()) return;
  method->prepare(input, T_map_odom * input.T_odom_base);
  if (take_back(words)) {
    break_expected = false;
  } else {
    method->not_found();
    break_expected = true;
  }
}

}  // namespace zloam::mapping
