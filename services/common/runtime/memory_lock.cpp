#include "common/runtime/memory_lock.hpp"

#include <sys/resource.h>
#include <sys/statvfs.h>
#include <unistd.h>

#include <cerrno>
#include <charconv>
#include <cstring>
#include <fstream>
#include <iterator>
#include <sstream>

#include "common/runtime/config.hpp"

namespace zloam::runtime {
namespace {

// linux/capability.h
constexpr unsigned kCapIpcLock = 14;

std::uint64_t effective_capabilities(std::string_view process_status) {
  constexpr std::string_view kName = "CapEff:\t";
  const std::size_t at = process_status.find(kName);
  if (at == std::string_view::npos) return 0;
  const std::string_view text = process_status.substr(at + kName.size(), 16);
  std::uint64_t value = 0;
  std::from_chars(text.data(), text.data() + text.size(), value, 16);
  return value;
}

}  // namespace

std::uint64_t lockable_bytes(std::string_view process_status, std::uint64_t limit) {
  const bool may = ((effective_capabilities(process_status) >> kCapIpcLock) & 1U) != 0;
  return may ? kUnlimited : limit;
}

std::uint64_t lockable_bytes() {
  rlimit limit{};
  if (getrlimit(RLIMIT_MEMLOCK, &limit) != 0) return kUnlimited;
  std::ostringstream status;
  status << std::ifstream("/proc/self/status").rdbuf();
  return lockable_bytes(status.str(),
                        limit.rlim_cur == RLIM_INFINITY ? kUnlimited : limit.rlim_cur);
}

// A program locks its own pool and the pools that it reads from: at most those of all stages that
// others read, and that of the tile store, which answers queries.
bool pools_fit(std::uint64_t lockable_bytes, int pool_mib) {
  const std::uint64_t pool = static_cast<std::uint64_t>(pool_mib) << 20;
  return lockable_bytes / (stages_that_are_read() + 2) >= pool;
}

// A file in shared memory takes up space only when it is written. If there is none left by then,
// the process ends with SIGBUS, so the space is checked before a pool is made.
std::string no_place_for_pools(const std::string& folder, int pool_mib) {
  struct statvfs about {};
  if (statvfs(folder.c_str(), &about) != 0 || access(folder.c_str(), W_OK) != 0) {
    return folder + ": " + std::strerror(errno);
  }
  const std::uint64_t whole = std::uint64_t{about.f_blocks} * about.f_frsize;
  const std::uint64_t left = std::uint64_t{about.f_bavail} * about.f_frsize;
  const std::uint64_t pool = static_cast<std::uint64_t>(pool_mib) << 20;
  if (whole < pool * stage_list().size()) {
    return folder + " has " + std::to_string(whole >> 20) + " MiB, and the stages' pools take " +
           std::to_string((pool * stage_list().size()) >> 20);
  }
  if (left < pool) {
    return folder + " has " + std::to_string(left >> 20) + " MiB left, and a pool takes " +
           std::to_string(pool_mib);
  }
  return {};
}

}  // namespace zloam::runtime
