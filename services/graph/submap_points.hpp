#pragma once
// The points of a run's submaps, kept in an unnamed file until the map is written: the graph itself
// needs only their surfaces.

#include <cstdint>
#include <string>
#include <vector>

#include "common/geometry/point.hpp"
#include "common/geometry/unnamed_file.hpp"

namespace zloam::graph {

class SubmapPoints {
 public:
  /// folder: where the file lies; empty: nothing is kept.
  explicit SubmapPoints(std::string folder) : folder_(std::move(folder)), file_(folder_) {}

  /// Adds the next submap's points. If writing fails, no more are kept, and complete() is false.
  void add(const std::vector<MapPoint>& points);
  /// Points of the submap with this number, from 0; empty: the file can't be read.
  std::vector<MapPoint> of(std::size_t submap) const;
  std::size_t submaps() const { return places_.size(); }
  /// Number of points of all submaps.
  std::size_t count() const { return count_; }
  /// All points added are available.
  bool complete() const { return !folder_.empty() && !file_.failed(); }

 private:
  struct Place {
    std::int64_t offset;
    std::size_t count;
  };

  std::string folder_;
  UnnamedFile file_;
  std::vector<Place> places_;
  std::size_t count_ = 0;
};

}  // namespace zloam::graph
