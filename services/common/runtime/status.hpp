#pragma once
// The status and the configuration of an instance as messages.

#include <cstdint>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "common/messages/build.hpp"
#include "common/runtime/account.hpp"
#include "common/runtime/stage.hpp"
#include "common/runtime/statistics.hpp"

namespace zloam::runtime {

/// The reason in the status of an instance that waits, as intended, until it is needed.
inline constexpr std::string_view kStandingBy = "standing by";

struct OutputAccountFields {
  std::string key;
  std::uint64_t published = 0, bytes = 0, republished = 0;
};

struct TransferFields {
  std::uint64_t bytes_in_place = 0, bytes_copied = 0, messages_shm = 0, messages_net = 0;
};

struct StatusFields {
  Identity identity;
  ServiceHealth health = ServiceHealth::kStarting;
  std::string reason;
  std::int64_t stamp_ns = 0, started_ns = 0;
  std::uint64_t run = 0, last_sweep = 0;
  bool has_sweep = false, end_of_run = false;
  std::vector<Account> inputs;
  std::vector<OutputAccountFields> outputs;
  std::vector<LatencySummary> latencies;
  std::map<std::string, double> figures;
  ProcessUsage usage;
  double rss_start_mib = 0;
  TransferFields transfer;
  std::uint32_t config_rev = 0;
};

Buffer build(const StatusFields& fields);
Buffer build_config(const Identity& identity, std::uint32_t config_rev,
                    const std::string& values_json, const std::string& result_hash);

}  // namespace zloam::runtime
