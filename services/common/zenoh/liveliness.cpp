#include "common/zenoh/reply.hpp"
#include "common/zenoh/session_impl.hpp"

namespace zloam::zenoh {

struct LivelinessToken::Impl {
  std::shared_ptr<Session::Impl> session;  // destroyed after the handle
  detail::Handle<zloam_token, zloam_token_drop> handle;
};

LivelinessToken::LivelinessToken(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
LivelinessToken::LivelinessToken(LivelinessToken&&) noexcept = default;
LivelinessToken& LivelinessToken::operator=(LivelinessToken&&) noexcept = default;
LivelinessToken::~LivelinessToken() = default;

LivelinessToken Session::declare_liveliness_token(std::string_view key) {
  auto impl = std::make_unique<LivelinessToken::Impl>();
  impl->session = impl_;
  zloam_token* handle = nullptr;
  detail::check(zloam_session_declare_token(impl_->handle.get(), detail::slice(key), &handle), key);
  impl->handle.reset(handle);
  return LivelinessToken(std::move(impl));
}

Subscriber Session::declare_liveliness_subscriber(std::string_view key,
                                                  std::function<void(Sample&&)> callback,
                                                  bool history) {
  auto impl = std::make_unique<Subscriber::Impl>();
  impl->session = impl_;
  void* context = detail::SampleClosure::make(std::move(callback), impl_->errors);
  zloam_subscriber* handle = nullptr;
  detail::check(zloam_session_declare_liveliness_subscriber(
                    impl_->handle.get(), detail::slice(key), history, detail::call_with_sample,
                    context, detail::SampleClosure::drop, &handle),
                key);
  impl->handle.reset(handle);
  return Subscriber(std::move(impl));
}

std::vector<std::string> Session::liveliness_get(std::string_view key,
                                                 std::chrono::milliseconds timeout) {
  detail::ReplyCollector collector;
  detail::start_get(
      {collector.on_reply(), collector.on_done()}, impl_->errors, key, [&](void* context) {
        return zloam_session_liveliness_get(impl_->handle.get(), detail::slice(key),
                                            detail::to_ms(timeout), detail::call_with_reply,
                                            context, detail::drop_get);
      });
  std::vector<std::string> keys;
  for (const Reply& reply : collector.wait(timeout)) {
    if (reply.ok()) keys.push_back(reply.sample->key);
  }
  return keys;
}

}  // namespace zloam::zenoh
