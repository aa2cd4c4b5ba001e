#include "common/zenoh/session_impl.hpp"

namespace zloam::zenoh {

Subscriber::Subscriber(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
Subscriber::Subscriber(Subscriber&&) noexcept = default;
Subscriber& Subscriber::operator=(Subscriber&&) noexcept = default;
Subscriber::~Subscriber() = default;

Subscriber Session::declare_subscriber(std::string_view key,
                                       std::function<void(Sample&&)> callback) {
  auto impl = std::make_unique<Subscriber::Impl>();
  impl->session = impl_;
  void* context = detail::SampleClosure::make(std::move(callback), impl_->errors);
  zloam_subscriber* handle = nullptr;
  detail::check(zloam_session_declare_subscriber(impl_->handle.get(), detail::slice(key),
                                                 detail::call_with_sample, context,
                                                 detail::SampleClosure::drop, &handle),
                key);
  impl->handle.reset(handle);
  return Subscriber(std::move(impl));
}

}  // namespace zloam::zenoh
