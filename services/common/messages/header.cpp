#include "common/messages/header.hpp"

namespace zloam {
namespace {

std::string text(const flatbuffers::String* s) { return s == nullptr ? std::string() : s->str(); }

TraceStamp stamp_of(const msg::TracePoint& point) {
  return {text(point.stage()), text(point.host()), text(point.instance()),
          point.received_ns(), point.started_ns(), point.published_ns()};
}

}  // namespace

HeaderFields header_fields(const msg::Header& header) {
  HeaderFields f;
  f.robot = text(header.robot());
  f.sensor = text(header.sensor());
  f.run = header.run();
  f.sweep = header.sweep();
  f.stamp_ns = header.stamp_ns();
  f.frame = text(header.frame());
  f.seq = header.seq();
  f.term = header.term();
  f.instance = text(header.instance());
  f.odom_epoch = header.odom_epoch();
  f.map_id = header.map_id();
  f.config_rev = header.config_rev();
  if (header.trace() != nullptr) {
    for (const msg::TracePoint* point : *header.trace()) f.trace.push_back(stamp_of(*point));
  }
  f.end_of_run = header.end_of_run();
  f.last_packet_ns = header.last_packet_ns();
  f.replay = header.replay();
  return f;
}

flatbuffers::Offset<msg::Header> build_header(flatbuffers::FlatBufferBuilder& b,
                                              const HeaderFields& f) {
  std::vector<flatbuffers::Offset<msg::TracePoint>> trace;
  trace.reserve(f.trace.size());
  for (const TraceStamp& t : f.trace) {
    const auto stage = b.CreateSharedString(t.stage);
    const auto host = b.CreateSharedString(t.host);
    const auto instance = b.CreateSharedString(t.instance);
    trace.push_back(msg::CreateTracePoint(b, stage, host, instance, t.received_ns, t.started_ns,
                                          t.published_ns));
  }
  const auto robot = b.CreateSharedString(f.robot);
  const auto sensor = b.CreateSharedString(f.sensor);
  const auto frame = b.CreateSharedString(f.frame);
  const auto instance = b.CreateSharedString(f.instance);
  const auto points = b.CreateVector(trace);
  return msg::CreateHeader(b, robot, sensor, f.run, f.sweep, f.stamp_ns, frame, f.seq, f.term,
                           instance, f.odom_epoch, f.map_id, f.config_rev, points, f.end_of_run,
                           f.last_packet_ns, f.replay);
}

}  // namespace zloam
