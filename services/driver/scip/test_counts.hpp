#pragma once
// Shared by the tests of the client.

#include <gtest/gtest.h>

#include <cstdint>
#include <string_view>

#include "driver/scip/client.hpp"

namespace zloam::driver::scip {

/// One of the client's counts by its name, which must exist.
inline std::uint64_t count_of(const Client& client, std::string_view name) {
  for (const auto& [key, value] : client.counts()) {
    if (key == name) return value;
  }
  ADD_FAILURE() << "no count " << name;
  return 0;
}

}  // namespace zloam::driver::scip
