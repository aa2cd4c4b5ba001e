#pragma once
// Which matched sweeps go into the map. Depends on sweeps and poses only, never on load or time.

#include <cstdint>
#include <deque>
#include <optional>
#include <string>

#include "common/geometry/se3.hpp"
#include "mapping/config.hpp"

namespace zloam::mapping {

class InsertionPolicy {
 public:
  explicit InsertionPolicy(const MappingConfig& config) : config_(config) {}

  void configure(const MappingConfig& config) { config_ = config; }

  /// Empty: insert; else why not. To be asked once for each matched sweep. A residual is compared
  /// with the median of the sweeps matched before, inserted or not, so that a lasting change of the
  /// surroundings does not shut the map for ever.
  std::string judge(const Pose& T_map_base, double residual_m);
  /// So many in a row, up to the last one judged, had a residual above it.
  std::uint32_t worse_in_row() const { return worse_; }
  void inserted_at(const Pose& T_map_base) { last_inserted_ = T_map_base; }
  /// All that it knows but its configuration, for who keeps or brings it back.
  template <class Bits>
  void each(Bits& bits) {
    bits(residuals_, worse_, last_inserted_);
  }
  /// Nothing to compare with: 0.
  double median_residual_m() const;

 private:
  MappingConfig config_;
  std::deque<double> residuals_;
  std::uint32_t worse_ = 0;
  std::optional<Pose> last_inserted_;
};

}  // namespace zloam::mapping
