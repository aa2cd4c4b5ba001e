#include <cstring>

#include "common/zenoh/detail.hpp"

namespace zloam::zenoh {

struct Bytes::Impl {
  explicit Impl(zloam_bytes* owned) : handle(owned) {}
  // Tells ThreadSanitizer that reads through this handle happen before the memory is freed.
  ~Impl() {
    if constexpr (detail::kThreadSanitizer) detail::hand_over(view().data);
  }

  /// Data is null when the bytes are empty or in several fragments.
  zloam_slice view() const {
    zloam_slice slice{};
    zloam_bytes_view(handle.get(), &slice);
    return slice;
  }

  detail::Handle<zloam_bytes, zloam_bytes_drop> handle;
};

namespace {

/// Memory of C++ with its owner, so that ThreadSanitizer learns that it is freed after all reads.
struct OwnedMemory {
  const void* data;
  void* context;
  void (*drop)(void*);

  static void free(void* self) {
    auto* memory = static_cast<OwnedMemory*>(self);
    detail::take_over(memory->data);
    memory->drop(memory->context);
    delete memory;
  }
};

}  // namespace

Bytes::Bytes() = default;
Bytes::Bytes(std::shared_ptr<Impl> impl) : impl_(std::move(impl)) {}

Bytes Bytes::copy_of(std::span<const std::uint8_t> data) {
  zloam_bytes* handle = nullptr;
  detail::check(zloam_bytes_copy({data.data(), data.size()}, &handle), "bytes");
  return detail::adopt(handle);
}

Bytes Bytes::copy_of(std::string_view text) {
  return copy_of(std::span(reinterpret_cast<const std::uint8_t*>(text.data()), text.size()));
}

Bytes Bytes::from_owner(const std::uint8_t* data, std::size_t size, void* context,
                        void (*drop)(void*)) {
  if constexpr (detail::kThreadSanitizer) {
    context = new OwnedMemory{data, context, drop};
    drop = OwnedMemory::free;
    detail::hand_over(data);
  }
  zloam_bytes* handle = nullptr;
  detail::check(zloam_bytes_own(data, size, context, drop, &handle), "bytes");
  return detail::adopt(handle);
}

Bytes Bytes::in_parts(std::size_t part) const {
  if (!impl_) return {};
  zloam_bytes* handle = nullptr;
  detail::check(zloam_bytes_in_parts(impl_->handle.get(), part, &handle), "bytes");
  return detail::adopt(handle);
}

std::size_t Bytes::size() const { return impl_ ? zloam_bytes_size(impl_->handle.get()) : 0; }

bool Bytes::is_shared_memory() const {
  return impl_ && zloam_bytes_is_shared_memory(impl_->handle.get());
}

bool Bytes::is_intact() const { return !impl_ || zloam_bytes_is_intact(impl_->handle.get()); }

std::optional<std::span<const std::uint8_t>> Bytes::contiguous() const {
  if (!impl_) return std::span<const std::uint8_t>();
  zloam_slice slice{};
  if (!zloam_bytes_view(impl_->handle.get(), &slice)) return std::nullopt;
  detail::take_over(slice.data);
  return std::span(slice.data, slice.size);
}

void Bytes::copy_to(std::uint8_t* dst) const {
  if (const auto bytes = contiguous()) {
    if (!bytes->empty()) std::memcpy(dst, bytes->data(), bytes->size());
  } else {
    zloam_bytes_copy_to(impl_->handle.get(), dst);
  }
}

std::string Bytes::to_string() const {
  std::string text(size(), '\0');
  copy_to(reinterpret_cast<std::uint8_t*>(text.data()));
  return text;
}

namespace detail {

Bytes adopt(zloam_bytes* handle) {
  if (handle == nullptr) return {};
  Handle<zloam_bytes, zloam_bytes_drop> owned(handle);
  auto impl = std::make_shared<Bytes::Impl>(nullptr);
  impl->handle = std::move(owned);
  return Bytes(std::move(impl));
}

const zloam_bytes* borrow(const Bytes& bytes) {
  return bytes.impl() ? bytes.impl()->handle.get() : nullptr;
}

Sample to_sample(const zloam_sample& view) {
  Sample sample;
  // Handles first: whatever fails later, they are freed.
  Handle<zloam_bytes, zloam_bytes_drop> attachment(view.attachment);
  sample.payload = adopt(view.payload);
  sample.attachment = adopt(attachment.release());
  sample.key = text(view.key);
  sample.encoding = text(view.encoding);
  sample.kind = static_cast<SampleKind>(view.kind);
  sample.priority = static_cast<Priority>(view.priority);
  sample.congestion_control = static_cast<CongestionControl>(view.congestion_control);
  sample.express = view.express;
  return sample;
}

void call_with_sample(void* context, const zloam_sample* sample) noexcept {
  SampleClosure::call(context, [&](auto& callback) { callback(to_sample(*sample)); });
}

}  // namespace detail
}  // namespace zloam::zenoh
