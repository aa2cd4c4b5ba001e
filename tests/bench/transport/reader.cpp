#include "reader.hpp"

#include <chrono>
#include <cstring>
#include <thread>

#include "payload.hpp"
#include "samples.hpp"

namespace zloam::bench {
namespace {

bool as_sent(const msg::Sweep& sweep) {
  const PointSpan points = points_of(sweep.points());
  for (std::size_t i = 0; i < points.size(); ++i) {
    const Point expected = point_of(sweep.header()->sweep(), i);
    // The comparison of bytes is intended. NOLINTNEXTLINE(bugprone-suspicious-memory-comparison)
    if (std::memcmp(&points[i], &expected, sizeof expected) != 0) return false;
  }
  return !points.empty();
}

}  // namespace

void bind(runtime::Parameters& p, const std::string& section, ReaderConfig& c) {
  p.add(section + ".work_ms", &c.work_ms, {0, 10'000}, "ms", "time spent on each message");
  p.add(section + ".report", &c.report, "JSON file of the result", runtime::Effect::kNone);
}

Reader::Reader(const ReaderConfig& config, runtime::Stage& stage)
    : config_(config), stage_(stage), ack_(stage.flow_ack(stage.identity().stage)) {
  stage.inlet<msg::Sweep>(Key::kSweep, {},
                          [this](const runtime::Received<msg::Sweep>& sweep) { read(sweep); });
  stage.on_end_of_run([this](std::uint64_t) { stage_.stop(); });
  stage.on_stop([this] { report(); });
}

void Reader::read(const runtime::Received<msg::Sweep>& sweep) {
  const std::int64_t published_ns = (*sweep.header().trace()->rbegin())->published_ns();
  if (!sweep.raw().recovered) {
    latency_ms_.push_back(static_cast<double>(sweep.raw().received_ns - published_ns) * 1e-6);
  }
  ++read_;
  out_of_order_ += sweep.sweep() < next_;
  next_ = sweep.sweep() + 1;
  if (!as_sent(*sweep)) ++wrong_;
  if (config_.work_ms > 0) std::this_thread::sleep_for(std::chrono::milliseconds(config_.work_ms));
  ack_.done_below(sweep.run(), sweep.sweep() + 1);
}

void Reader::report() const {
  const runtime::Account account = stage_.accounts().at(0);
  const auto dropped = account.dropped.at(static_cast<std::size_t>(runtime::Drop::kQueueFull));
  write_report(config_.report, {{"read", std::to_string(read_)},
                                {"wrong", std::to_string(wrong_)},
                                {"out_of_order", std::to_string(out_of_order_)},
                                {"lost", std::to_string(account.lost)},
                                {"queue_full", std::to_string(dropped)},
                                {"recovered", std::to_string(account.recovered)},
                                {"balanced", account.balanced() ? "true" : "false"},
                                {"latency_ms", json_list(latency_ms_)}});
}

}  // namespace zloam::bench
