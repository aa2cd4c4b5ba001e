#include "common/runtime/account.hpp"

#include <numeric>

namespace zloam::runtime {

const char* drop_name(Drop reason) {
  constexpr std::array<const char*, kDropReasons> kNames = {"duplicate",  "fenced",  "late",
                                                            "queue_full", "garbage", "wrong_run",
                                                            "invalid",    "failed",  "torn"};
  return kNames[static_cast<std::size_t>(reason)];
}

std::uint64_t Account::dropped_total() const {
  return std::accumulate(dropped.begin(), dropped.end(), std::uint64_t{0});
}

}  // namespace zloam::runtime
