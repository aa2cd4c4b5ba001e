#include "common/zenoh/session_impl.hpp"

namespace zloam::zenoh {

struct Publisher::Impl {
  std::shared_ptr<Session::Impl> session;  // destroyed after the handle
  std::string key;
  detail::Handle<zloam_publisher, zloam_publisher_drop> handle;
};

namespace {

zloam_publisher_options to_c(const PublisherOptions& options) {
  zloam_publisher_options c{};
  c.encoding = detail::slice(options.encoding);
  c.congestion_control = static_cast<std::uint8_t>(options.congestion_control);
  c.priority = static_cast<std::uint8_t>(options.priority);
  c.express = options.express;
  c.reliable = options.reliable;
  return c;
}

using MatchingClosure = detail::Closure<std::function<void(bool)>>;

void call_with_matching(void* context, bool matching) noexcept {
  MatchingClosure::call(context, [&](auto& callback) { callback(matching); });
}

}  // namespace

Publisher::Publisher(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
Publisher::Publisher(Publisher&&) noexcept = default;
Publisher& Publisher::operator=(Publisher&&) noexcept = default;
Publisher::~Publisher() = default;

void Publisher::put(const Bytes& payload, const Bytes& attachment) {
  detail::check(
      zloam_publisher_put(impl_->handle.get(), detail::borrow(payload), detail::borrow(attachment)),
      impl_->key);
}

void Publisher::delete_resource() {
  detail::check(zloam_publisher_delete(impl_->handle.get()), impl_->key);
}

bool Publisher::matching() const {
  bool matching = false;
  detail::check(zloam_publisher_matching(impl_->handle.get(), &matching), impl_->key);
  return matching;
}

void Publisher::on_matching(std::function<void(bool)> callback) {
  void* context = MatchingClosure::make(std::move(callback), impl_->session->errors);
  detail::check(zloam_publisher_on_matching(impl_->handle.get(), call_with_matching, context,
                                            MatchingClosure::drop),
                impl_->key);
}

const std::string& Publisher::key() const { return impl_->key; }

Publisher Session::declare_publisher(std::string_view key, const PublisherOptions& options) {
  const zloam_publisher_options c = to_c(options);
  auto impl = std::make_unique<Publisher::Impl>();
  impl->session = impl_;
  impl->key = key;
  zloam_publisher* handle = nullptr;
  detail::check(
      zloam_session_declare_publisher(impl_->handle.get(), detail::slice(key), &c, &handle),
      impl->key);
  impl->handle.reset(handle);
  return Publisher(std::move(impl));
}

void Session::put(std::string_view key, const Bytes& payload, const PublisherOptions& options) {
  const zloam_publisher_options c = to_c(options);
  detail::check(
      zloam_session_put(impl_->handle.get(), detail::slice(key), detail::borrow(payload), &c), key);
}

void Session::delete_resource(std::string_view key) {
  detail::check(zloam_session_delete(impl_->handle.get(), detail::slice(key)), key);
}

}  // namespace zloam::zenoh
