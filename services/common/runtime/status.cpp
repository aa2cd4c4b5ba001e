#include "common/runtime/status.hpp"

#include <unistd.h>

namespace zloam::runtime {
namespace {

using Builder = flatbuffers::FlatBufferBuilder;

flatbuffers::Offset<msg::InputAccount> input(Builder& b, const Account& a) {
  std::vector<flatbuffers::Offset<msg::DropCount>> drops;
  for (std::size_t i = 0; i < kDropReasons; ++i) {
    if (a.dropped[i] == 0) continue;
    drops.push_back(
        msg::CreateDropCount(b, b.CreateString(drop_name(static_cast<Drop>(i))), a.dropped[i]));
  }
  const auto key = b.CreateString(a.key);
  const auto list = b.CreateVector(drops);
  return msg::CreateInputAccount(b, key, a.received, a.processed, a.not_mine, a.queued, a.in_work,
                                 list, a.lost, a.recovered);
}

template <class T, class Items, class Make>
auto list_of(Builder& b, const Items& items, Make make) {
  std::vector<flatbuffers::Offset<T>> offsets;
  offsets.reserve(items.size());
  for (const auto& item : items) offsets.push_back(make(item));
  return b.CreateVector(offsets);
}

struct Lists {
  flatbuffers::Offset<flatbuffers::Vector<flatbuffers::Offset<msg::InputAccount>>> inputs;
  flatbuffers::Offset<flatbuffers::Vector<flatbuffers::Offset<msg::OutputAccount>>> outputs;
  flatbuffers::Offset<flatbuffers::Vector<flatbuffers::Offset<msg::Latency>>> latencies;
  flatbuffers::Offset<flatbuffers::Vector<flatbuffers::Offset<msg::Figure>>> figures;
};

Lists lists(Builder& b, const StatusFields& f) {
  Lists l;
  l.inputs = list_of<msg::InputAccount>(b, f.inputs, [&](const Account& a) { return input(b, a); });
  l.outputs = list_of<msg::OutputAccount>(b, f.outputs, [&](const OutputAccountFields& o) {
    return msg::CreateOutputAccount(b, b.CreateString(o.key), o.published, o.bytes, o.republished);
  });
  l.latencies = list_of<msg::Latency>(b, f.latencies, [&](const LatencySummary& s) {
    return msg::CreateLatency(b, b.CreateString(s.name), s.count, s.p50_ms, s.p95_ms, s.p99_ms,
                              s.max_ms);
  });
  l.figures = list_of<msg::Figure>(b, f.figures, [&](const auto& figure) {
    return msg::CreateFigure(b, b.CreateString(figure.first), figure.second);
  });
  return l;
}

}  // namespace

Buffer build(const StatusFields& f) {
  Builder b;
  const Lists l = lists(b, f);
  const auto robot = b.CreateString(f.identity.robot);
  const auto stage = b.CreateString(f.identity.stage);
  const auto instance = b.CreateString(f.identity.instance);
  const auto host = b.CreateString(f.identity.host);
  const auto version = b.CreateString(f.identity.version);
  const auto reason = b.CreateString(f.reason);
  msg::StatusBuilder m(b);
  m.add_robot(robot);
  m.add_stage(stage);
  m.add_instance(instance);
  m.add_host(host);
  m.add_pid(static_cast<std::uint32_t>(getpid()));
  m.add_version(version);
  m.add_health(static_cast<msg::ServiceHealth>(f.health));
  m.add_reason(reason);
  m.add_stamp_ns(f.stamp_ns);
  m.add_started_ns(f.started_ns);
  m.add_run(f.run);
  m.add_last_sweep(f.last_sweep);
  m.add_has_sweep(f.has_sweep);
  m.add_end_of_run(f.end_of_run);
  m.add_inputs(l.inputs);
  m.add_outputs(l.outputs);
  m.add_latencies(l.latencies);
  m.add_figures(l.figures);
  m.add_cpu_ms(f.usage.cpu_ms);
  m.add_rss_start_mib(f.rss_start_mib);
  m.add_rss_now_mib(f.usage.rss_mib);
  m.add_rss_peak_mib(f.usage.rss_peak_mib);
  m.add_bytes_in_place(f.transfer.bytes_in_place);
  m.add_bytes_copied(f.transfer.bytes_copied);
  m.add_messages_shm(f.transfer.messages_shm);
  m.add_messages_net(f.transfer.messages_net);
  m.add_config_rev(f.config_rev);
  b.Finish(m.Finish(), Kind<msg::Status>::kIdentifier);
  return b.Release();
}

Buffer build_config(const Identity& identity, std::uint32_t config_rev,
                    const std::string& values_json, const std::string& result_hash) {
  Builder b;
  const auto stage = b.CreateString(identity.stage);
  const auto instance = b.CreateString(identity.instance);
  const auto values = b.CreateString(values_json);
  const auto hash = b.CreateString(result_hash);
  b.Finish(msg::CreateEffectiveConfig(b, stage, instance, config_rev, values, hash),
           Kind<msg::EffectiveConfig>::kIdentifier);
  return b.Release();
}

}  // namespace zloam::runtime
