#pragma once
// CRC-32C (Castagnoli): reflected polynomial 0x82F63B78, initial and final value all ones (RFC
// 3720, appendix B.4).

#include <cstdint>
#include <span>

namespace zloam::store {

std::uint32_t crc32c(std::span<const std::uint8_t> bytes);

}  // namespace zloam::store
