#pragma once
// Zenoh locks into memory every shared-memory pool that a process creates or reads. When the limit
// is reached, a reader can't open a publisher's pool and loses each message in it without any
// error.

#include <cstdint>
#include <limits>
#include <string>
#include <string_view>

namespace zloam::runtime {

inline constexpr std::uint64_t kUnlimited = std::numeric_limits<std::uint64_t>::max();

/// Bytes that this process may lock: its own limit, or none with CAP_IPC_LOCK.
std::uint64_t lockable_bytes();
/// The same from the text of /proc/self/status and RLIMIT_MEMLOCK.
std::uint64_t lockable_bytes(std::string_view process_status, std::uint64_t limit);

/// Whether a stage can lock its own pool and those of all stages that it may read from.
bool pools_fit(std::uint64_t lockable_bytes, int pool_mib);

/// Folder of the shared memory.
inline constexpr const char* kSharedMemoryFolder = "/dev/shm";

/// Why the folder can't hold the pools: it is missing or not writable, too small for all stages'
/// pools, or too full for this one's. Empty: it can.
std::string no_place_for_pools(const std::string& folder, int pool_mib);

}  // namespace zloam::runtime
