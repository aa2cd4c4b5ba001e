#pragma once
// Configuration of the graph of loops. Every default is written here and nowhere else; keys of the
// robot's file and their meaning: graph_parameters.cpp. The fields that it does not bind are
// constants of the method (docs/experiments/2026-11-27-loops.md).

#include <cstddef>
#include <string>

namespace zloam::graph {

struct PlaceConfig {
  /// of the image seen along gravity, and half its edge
  double cell_m = 0.5;
  double half_m = 40.0;
  /// height levels counted in a cell, and the highest one above the lowest point around
  double level_m = 0.3;
  double highest_m = 10.0;
  int features = 200;
  /// maximum of differing bits, of 256, between two descriptors of one corner
  int most_different_bits = 70;
  /// radius within which matched corners agree on one place, and the fewest of them
  double agree_m = 1.5;
  std::size_t fewest_agreeing = 8;
};

struct VerifyConfig {
  /// surfaces to be matched, and the range from the sensor within which a submap counts
  std::size_t surfaces = 1000;
  double reach_m = 40.0;
  /// parts of one submap this near to the other's sensor should be in the other
  double radius_m = 25.0;
  double gate_start_m = 1.5, gate_end_m = 0.2;
  int iterations = 24;
  /// share of the planes off the ground that must coincide with a plane of the other, both ways
  double overlap = 0.4;
  /// least share of the horizontal normals along any direction
  double weakest_share = 0.04;
  /// another place with at least this share of the best one's quality is a further candidate
  double unique_share = 0.85;
  /// error of the submaps themselves, one sigma
  double sigma_m = 0.005;
  double sigma_rad = 0.0005;
};

struct GraphConfig {
  /// way between two submaps that may close a loop, m
  double loop_way_m = 40.0;
  /// places that are verified for a submap
  std::size_t candidates = 3;
  /// assumed drift of the mapping while a loop is searched for: share of the way, and rotation per
  /// metre
  double drift_share = 0.01;
  double drift_rad_per_m = 0.0003;
  /// squared distance of a loop from the expectation, six degrees of freedom: 99.9 %
  double most_chi2 = 22.46;
  /// loops confirm each other within this way on both sides
  double confirm_way_m = 40.0;
  PlaceConfig place;
  VerifyConfig verify;
  std::string output_dir = "out";
};

}  // namespace zloam::graph
