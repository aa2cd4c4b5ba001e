#pragma once
// Publishes sweeps of a chosen size, as fast as they are acknowledged or at a fixed rate.

#include <chrono>
#include <cstdint>
#include <string>
#include <vector>

#include "common/runtime/stage.hpp"

namespace zloam::bench {

struct PublisherConfig {
  int count = 1000;
  /// points of one message; a point has 24 bytes
  int points = 436'907;
  /// 0: a replay, paced by acknowledgements; else live with this rate of messages
  double rate_hz = 0.0;
  /// live: start when this number of readers is present
  int readers = 1;
  std::string report;
};

void bind(runtime::Parameters& parameters, PublisherConfig& config);

class Publisher {
 public:
  Publisher(const PublisherConfig& config, runtime::Stage& stage);

 private:
  runtime::Poll poll();
  void tick();
  void publish_next();
  bool readers_are_there();
  void report() const;

  const PublisherConfig& config_;
  runtime::Stage& stage_;
  runtime::Outlet& out_;
  runtime::FlowWindow& window_;
  PointVector points_;
  std::uint64_t next_ = 0;
  bool started_ = false;
  std::chrono::steady_clock::time_point first_;
  std::vector<double> put_ms_;
};

}  // namespace zloam::bench
