#include "common/containers/flat_index.hpp"

#include <bit>

namespace zloam {

FlatIndex::FlatIndex(std::size_t capacity) {
  const std::size_t slots = std::bit_ceil(capacity < 16 ? std::size_t{16} : capacity);
  keys_.assign(slots, kFree);
  values_.resize(slots);
  mask_ = slots - 1;
  shift_ = 64U - static_cast<unsigned>(std::countr_zero(slots));
}

void FlatIndex::insert(std::uint64_t key, std::uint32_t value) {
  if (4 * (size_ + 1) > 3 * keys_.size()) grow();
  std::size_t at = home(key);
  while (keys_[at] != kFree) at = (at + 1) & mask_;
  keys_[at] = key;
  values_[at] = value;
  ++size_;
}

void FlatIndex::grow() {
  FlatIndex larger(keys_.size() * 2);
  for (std::size_t at = 0; at < keys_.size(); ++at) {
    if (keys_[at] != kFree) larger.insert(keys_[at], values_[at]);
  }
  *this = std::move(larger);
}

void FlatIndex::erase(std::uint64_t key) {
  std::size_t at = home(key);
  while (keys_[at] != kFree && keys_[at] != key) at = (at + 1) & mask_;
  if (keys_[at] == kFree) return;
  // Moves later members of the run back over the hole, so that no search ends too early.
  std::size_t next = at;
  for (;;) {
    next = (next + 1) & mask_;
    if (keys_[next] == kFree) break;
    const std::size_t distance_home = (next - home(keys_[next])) & mask_;
    if (distance_home >= ((next - at) & mask_)) {
      keys_[at] = keys_[next];
      values_[at] = values_[next];
      at = next;
    }
  }
  keys_[at] = kFree;
  --size_;
}

}  // namespace zloam
