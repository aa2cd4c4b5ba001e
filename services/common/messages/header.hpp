#pragma once
// The header that every message carries, as a plain struct: copied from the message that caused a
// new one, with one trace point appended by each stage.

#include <flatbuffers/flatbuffers.h>

#include <cstdint>
#include <string>
#include <vector>

#include "schemas/common_generated.h"

namespace zloam {

/// When one stage received, started and published a sweep: its host's clock, ns since the Unix
/// epoch.
struct TraceStamp {
  std::string stage;
  std::string host;
  std::string instance;
  std::int64_t received_ns = 0;
  std::int64_t started_ns = 0;
  std::int64_t published_ns = 0;
};

/// Field by field msg::Header (schemas/common.fbs).
struct HeaderFields {
  std::string robot;
  std::string sensor;
  std::uint64_t run = 0;
  std::uint64_t sweep = 0;
  std::int64_t stamp_ns = 0;
  std::string frame;
  std::uint64_t seq = 0;
  std::uint32_t term = 0;
  std::string instance;
  std::uint32_t odom_epoch = 0;
  std::uint64_t map_id = 0;
  std::uint32_t config_rev = 0;
  std::vector<TraceStamp> trace;
  bool end_of_run = false;
  std::int64_t last_packet_ns = 0;
  bool replay = false;
};

HeaderFields header_fields(const msg::Header& header);
flatbuffers::Offset<msg::Header> build_header(flatbuffers::FlatBufferBuilder& builder,
                                              const HeaderFields& fields);

}  // namespace zloam
