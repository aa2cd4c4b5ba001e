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

  /// Empty: insert; else the reason against it. Call it once for each matched sweep. A residual is
  /// compared with the median of the sweeps matched before, inserted or not, so that a lasting
  /// change of the surroundings does not stop insertion for ever.
  std::string judge(const Pose& T_map_base, double residual_m);
  /// Number of sweeps in a row, up to the last one judged, with a residual above the limit.
  std::uint32_t worse_in_row() const { return worse_; }
  void inserted_at(const Pose& T_map_base) { last_inserted_ = T_map_base; }
  /// The whole state but the configuration, to save or restore it.
  template <class Bits>
  void each(Bits& bits) {
    bits(residuals_, worse_, last_inserted_);
  }
  /// 0: no residual yet.
  double median_residual_m() const;

 private:
  MappingConfig config_;
  std::deque<double> residuals_;
  std::uint32_t worse_ = 0;
  std::optional<Pose> last_inserted_;
};

}  // namespace zloam::mapping
