#pragma once
// How large a block to ask the heap for.

#include <cstddef>

namespace zloam {

/// Blocks of messages, some of them kept, that differ by little from one to the next leave holes
/// that the next one does not fit: the heap of a run of 7000 sweeps grew by a tenth. In steps it
/// stays.
inline constexpr std::size_t kBlockStep_bytes = std::size_t{64} << 10;

/// Blocks from here on a small heap (mapping's) gives back to the kernel as soon as they are free.
inline constexpr std::size_t kReturnedBlock_bytes = std::size_t{512} << 10;

/// Of at least so many bytes; small ones as they are.
constexpr std::size_t block_size(std::size_t bytes) {
  if (bytes < kBlockStep_bytes) return bytes;
  return (bytes + kBlockStep_bytes - 1) / kBlockStep_bytes * kBlockStep_bytes;
}

}  // namespace zloam
