#pragma once
// The points of a run's submaps, kept in a file without a name until the map is written: the graph
// itself needs their surfaces only.

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

  /// Of the next submap. Where they can't be kept, none is from now on, and complete() says so.
  void add(const std::vector<MapPoint>& points);
  /// Of the submap with this number, from 0; none: the file can't be read.
  std::vector<MapPoint> of(std::size_t submap) const;
  std::size_t submaps() const { return places_.size(); }
  /// Of all submaps.
  std::size_t count() const { return count_; }
  /// All that were added are here.
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
