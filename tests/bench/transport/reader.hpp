#pragma once
// Reads the publisher's sweeps and checks every byte; work_ms makes it a slow reader.

#include <cstdint>
#include <string>
#include <vector>

#include "common/runtime/stage.hpp"

namespace zloam::bench {

struct ReaderConfig {
  /// time that the reader spends on each message
  int work_ms = 0;
  std::string report;
};

void bind(runtime::Parameters& parameters, const std::string& section, ReaderConfig& config);

class Reader {
 public:
  Reader(const ReaderConfig& config, runtime::Stage& stage);

 private:
  void read(const runtime::Received<msg::Sweep>& sweep);
  void report() const;

  const ReaderConfig& config_;
  runtime::Stage& stage_;
  runtime::FlowAck& ack_;
  std::uint64_t read_ = 0;
  std::uint64_t wrong_ = 0;
  std::uint64_t out_of_order_ = 0;
  std::uint64_t next_ = 0;
  std::vector<double> latency_ms_;
};

}  // namespace zloam::bench
