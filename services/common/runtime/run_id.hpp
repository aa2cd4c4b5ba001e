#pragma once
// Identity of a replay: a function of the capture and of all configuration that can change a result
// (docs/protocol.md, section 1).

#include <cstdint>
#include <map>
#include <string>
#include <string_view>

namespace zloam::runtime {

/// SHA-256 in lower-case hexadecimal.
std::string sha256_hex(std::string_view text);

/// The first 8 bytes, most significant first, of the SHA-256 over the capture's hash and each
/// stage's result hash, stages ascending; never 0.
std::uint64_t replay_run_id(const std::string& capture_hash,
                            const std::map<std::string, std::string>& result_hash_by_stage);

}  // namespace zloam::runtime
