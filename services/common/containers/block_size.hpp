#pragma once
// Size of a block to request from the heap.

#include <cstddef>

namespace zloam {

/// Message blocks, some of them kept, that differ slightly in size leave holes that the next one
/// does not fit: the heap of a run of 7000 sweeps grew by a tenth. With sizes in steps it does not
/// grow.
inline constexpr std::size_t kBlockStep_bytes = std::size_t{64} << 10;

/// Freed blocks of at least this size go from a small heap (mapping's) back to the kernel at once.
inline constexpr std::size_t kReturnedBlock_bytes = std::size_t{512} << 10;

/// A size of at least `bytes`; small sizes are unchanged.
constexpr std::size_t block_size(std::size_t bytes) {
  if (bytes < kBlockStep_bytes) return bytes;
  return (bytes + kBlockStep_bytes - 1) / kBlockStep_bytes * kBlockStep_bytes;
}

}  // namespace zloam
