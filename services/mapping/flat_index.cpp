#include "mapping/flat_index.hpp"

#include <bit>

namespace zloam::mapping {

FlatIndex::FlatIndex(std::size_t capacity) {
  const std::size_t slots = std::bit_ceil(capacity < 16 ? std::size_t{16} : capacity);
  slots_.resize(slots);
  mask_ = slots - 1;
  shift_ = 64U - static_cast<unsigned>(std::countr_zero(slots));
}

void FlatIndex::insert(std::uint64_t key, std::uint32_t value) {
  if (2 * (size_ + 1) > slots_.size()) grow();
  std::size_t at = home(key);
  while (slots_[at].value != kNone) at = (at + 1) & mask_;
  slots_[at] = {key, value};
  ++size_;
}

void FlatIndex::grow() {
  FlatIndex larger(slots_.size() * 2);
  for (const Slot& slot : slots_) {
    if (slot.value != kNone) larger.insert(slot.key, slot.value);
  }
  *this = std::move(larger);
}

void FlatIndex::erase(std::uint64_t key) {
  std::size_t at = home(key);
  while (slots_[at].value != kNone && slots_[at].key != key) at = (at + 1) & mask_;
  if (slots_[at].value == kNone) return;
  // Moves later members of the run back over the hole, so that no search ends too early.
  std::size_t next = at;
  for (;;) {
    next = (next + 1) & mask_;
    if (slots_[next].value == kNone) break;
    const std::size_t distance_home = (next - home(slots_[next].key)) & mask_;
    if (distance_home >= ((next - at) & mask_)) {
      slots_[at] = slots_[next];
      at = next;
    }
  }
  slots_[at].value = kNone;
  --size_;
}

}  // namespace zloam::mapping
