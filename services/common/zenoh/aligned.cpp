#include "common/zenoh/aligned.hpp"

#include <mutex>
#include <new>
#include <utility>

#include "common/containers/block_size.hpp"

namespace zloam::zenoh {

namespace {

constexpr std::align_val_t kAlignment{kCopyAlignment};

struct Block {
  std::uint8_t* memory = nullptr;
  std::size_t capacity = 0;
};

void free_block(const Block& block) { ::operator delete(block.memory, kAlignment); }

/// The last large block that was given back: the next message is likely to have about its size, and
/// fresh pages cost as much as the copy.
class Spare {
 public:
  ~Spare() { free_block(spare_); }

  Block take(std::size_t size) {
    const std::lock_guard lock(mutex_);
    const bool fits = size <= spare_.capacity && spare_.capacity <= 2 * size;
    return fits ? std::exchange(spare_, {}) : Block{};
  }

  void give(Block block) {
    {
      const std::lock_guard lock(mutex_);
      std::swap(spare_, block);
    }
    free_block(block);
  }

 private:
  std::mutex mutex_;
  Block spare_;
};

std::shared_ptr<std::uint8_t> allocate(std::size_t size) {
  // Each block's deleter shares it, because messages may outlive this function's statics.
  static const auto kSpare = std::make_shared<Spare>();
  Block block = size < kReturnedBlock_bytes ? Block{} : kSpare->take(size);
  if (block.memory == nullptr) {
    const std::size_t capacity = block_size(size);
    block = {static_cast<std::uint8_t*>(::operator new(capacity, kAlignment)), capacity};
  }
  return {block.memory, [block, spare = kSpare](std::uint8_t*) {
            block.capacity < kReturnedBlock_bytes ? free_block(block) : spare->give(block);
          }};
}

bool is_aligned(const std::uint8_t* data) {
  return reinterpret_cast<std::uintptr_t>(data) % kInPlaceAlignment == 0;
}

void count(TransferCounters& counters, bool shared_memory, bool in_place, std::size_t size) {
  ++(shared_memory ? counters.messages_shared_memory : counters.messages_other);
  (in_place ? counters.bytes_in_place : counters.bytes_copied) += size;
}

/// A shared copy in the form that Bytes::own takes.
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
