#pragma once
// The payload: a cloud whose points are a function of the sweep's number, so that a reader can
// check every byte.

#include <cstddef>
#include <cstdint>

#include "common/geometry/point.hpp"

namespace zloam::bench {

inline Point point_of(std::uint64_t sweep, std::size_t index) {
  return {static_cast<float>(sweep),
          static_cast<float>(index),
          1.0F,
          10.0F,
          static_cast<std::uint32_t>(index),
          static_cast<std::uint16_t>(index % 16),
          ReturnType::kStrongest,
          0};
}

}  // namespace zloam::bench
