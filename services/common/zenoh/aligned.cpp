#include "common/zenoh/aligned.hpp"

#include <new>

namespace zloam::zenoh {

namespace {

std::shared_ptr<std::uint8_t> allocate(std::size_t size) {
  constexpr std::align_val_t kAlignment{kCopyAlignment};
  auto* memory = static_cast<std::uint8_t*>(::operator new(size, kAlignment));
  return {memory, [](std::uint8_t* p) { ::operator delete (p, std::align_val_t{kCopyAlignment}); }};
}

bool is_aligned(const std::uint8_t* data) {
  return reinterpret_cast<std::uintptr_t>(data) % kInPlaceAlignment == 0;
}

void count(TransferCounters& counters, bool shared_memory, bool in_place, std::size_t size) {
  ++(shared_memory ? counters.messages_shared_memory : counters.messages_other);
  (in_place ? counters.bytes_in_place : counters.bytes_copied) += size;
}

/// What Bytes::own takes.
struct SharedCopy {
  std::shared_ptr<const std::uint8_t> memory;
  std::size_t bytes;
  const std::uint8_t* data() const { return memory.get(); }
  std::size_t size() const { return bytes; }
};

}  // namespace

Bytes AlignedBytes::to_keep() const {
  return copy_ ? Bytes::own(SharedCopy{copy_, size()}) : Bytes::copy_of(data_);
}

AlignedBytes view_aligned(Bytes payload, TransferCounters* counters) {
  AlignedBytes view;
  const std::size_t size = payload.size();
  const auto bytes = payload.contiguous();
  const bool in_place = bytes && is_aligned(bytes->data()) && !payload.is_shared_memory();
  if (counters != nullptr) count(*counters, payload.is_shared_memory(), in_place, size);
  if (in_place) {
    view.data_ = *bytes;
    view.payload_ = std::move(payload);
    return view;
  }
  const auto copy = allocate(size);
  payload.copy_to(copy.get());
  view.torn_ = !payload.is_intact();
  if (view.torn_) return view;
  view.data_ = std::span<const std::uint8_t>(copy.get(), size);
  view.copy_ = copy;
  return view;
}

}  // namespace zloam::zenoh
