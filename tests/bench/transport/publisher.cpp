#include "publisher.hpp"

#include "common/zenoh/zenoh.hpp"
#include "payload.hpp"
#include "samples.hpp"

namespace zloam::bench {
namespace {

using Clock = std::chrono::steady_clock;

double ms_between(Clock::time_point begin, Clock::time_point end) {
  return std::chrono::duration<double, std::milli>(end - begin).count();
}

}  // namespace

void bind(runtime::Parameters& p, PublisherConfig& c) {
  p.add("driver.count", &c.count, {1, 1e6}, "", "messages to publish");
  p.add("driver.points", &c.points, {1, 1e7}, "", "points of one message, 24 bytes each");
  p.add("driver.rate_hz", &c.rate_hz, {0.0, 1000.0}, "Hz", "live at this rate; 0: a replay");
  p.add("driver.readers", &c.readers, {1, 16}, "", "live: readers to wait for");
  p.add("driver.report", &c.report, "JSON file of the result", runtime::Effect::kNone);
}

Publisher::Publisher(const PublisherConfig& config, runtime::Stage& stage)
    : config_(config),
      stage_(stage),
      out_(stage.outlet(Key::kSweep)),
      window_(stage.flow_window(out_)) {
  for (int i = 0; i < config.points; ++i)
    points_.push_back(point_of(0, static_cast<std::size_t>(i)));
  stage.on_stop([this] { report(); });
  if (config.rate_hz > 0.0) {
    window_.start_live();
    const std::chrono::duration<double> period(1.0 / config.rate_hz);
    stage.every(std::chrono::duration_cast<std::chrono::milliseconds>(period), [this] { tick(); });
  } else {
    window_.start_replay("transport-benchmark");
    stage.on_poll([this] { return poll(); });
  }
}

runtime::Poll Publisher::poll() {
  if (!window_.begun()) return runtime::Poll::kWait;
  if (next_ == static_cast<std::uint64_t>(config_.count)) {
    if (window_.finished()) stage_.stop();
    return runtime::Poll::kWait;
  }
  if (!window_.may_send(next_)) return runtime::Poll::kWait;
  publish_next();
  return runtime::Poll::kAgain;
}

// After its last message the publisher keeps running until it is stopped, to answer requests for
// lost messages.
void Publisher::tick() {
  if (next_ == static_cast<std::uint64_t>(config_.count) || !readers_are_there()) return;
  publish_next();
}

// A reader declares its token after its subscriptions on the same link, so the token implies them.
bool Publisher::readers_are_there() {
  if (!started_) {
    const std::string all = stage_.keys().alive("*", "*");
    const auto tokens = stage_.session().liveliness_get(all, std::chrono::milliseconds(500));
    std::size_t others = 0;
    for (const std::string& token : tokens) others += token.find("/driver/") == std::string::npos;
    started_ = others >= static_cast<std::size_t>(config_.readers);
  }
  return started_;
}

void Publisher::publish_next() {
  if (next_ == 0) first_ = Clock::now();
  for (Point& point : points_) point.x = static_cast<float>(next_);
  HeaderFields header = out_.header(stage_.now_ns(), stage_.now_ns());
  header.run = window_.run();
  header.sweep = next_;
  header.frame = "lidar";
  header.stamp_ns = stage_.now_ns();
  header.replay = window_.replay();
  header.end_of_run = next_ + 1 == static_cast<std::uint64_t>(config_.count);
  // The publication time in the trace was taken above, before the message is built.
  Buffer message = build(header, SweepFields{.points = points_, .rings = 16});
  const auto begin = Clock::now();
  out_.publish(header, std::move(message));
  put_ms_.push_back(ms_between(begin, Clock::now()));
  ++next_;
}

void Publisher::report() const {
  write_report(config_.report,
               {{"published", std::to_string(next_)},
                {"seconds", std::to_string(ms_between(first_, Clock::now()) * 1e-3)},
                {"put_ms", json_list(put_ms_)}});
}

}  // namespace zloam::bench
