#include <condition_variable>

#include "common/zenoh/reply.hpp"
#include "common/zenoh/session_impl.hpp"

namespace zloam::zenoh {

struct Query::Impl {
  detail::Handle<zloam_query, zloam_query_drop> handle;
  std::string key;
  std::string parameters;
  Bytes payload;
};

struct Queryable::Impl {
  std::shared_ptr<Session::Impl> session;  // destroyed after the handle
  detail::Handle<zloam_queryable, zloam_queryable_drop> handle;
};

namespace {

using QueryClosure = detail::Closure<std::function<void(Query&&)>>;

Query to_query(zloam_query* owned) {
  detail::Handle<zloam_query, zloam_query_drop> handle(owned);
  zloam_query_view view{};
  zloam_query_view_of(handle.get(), &view);
  Bytes payload = detail::adopt(view.payload);
  return Query(std::unique_ptr<Query::Impl>(
      new Query::Impl{std::move(handle), std::string(detail::text(view.key)),
                      std::string(detail::text(view.parameters)), std::move(payload)}));
}

void call_with_query(void* context, zloam_query* query) noexcept {
  QueryClosure::call(context, [&](auto& callback) { callback(to_query(query)); });
}

}  // namespace

Query::Query(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
Query::Query(Query&&) noexcept = default;
Query& Query::operator=(Query&&) noexcept = default;
Query::~Query() = default;

Queryable::Queryable(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
Queryable::Queryable(Queryable&&) noexcept = default;
Queryable& Queryable::operator=(Queryable&&) noexcept = default;
Queryable::~Queryable() = default;

const std::string& Query::key() const { return impl_->key; }
const std::string& Query::parameters() const { return impl_->parameters; }
const Bytes& Query::payload() const { return impl_->payload; }

void Query::reply(std::string_view key, const Bytes& payload, std::string_view encoding,
                  const Bytes& attachment) {
  detail::check(zloam_query_reply(impl_->handle.get(), detail::slice(key), detail::borrow(payload),
                                  detail::slice(encoding), detail::borrow(attachment)),
                key);
}

void Query::reply_error(const Bytes& payload) {
  detail::check(zloam_query_reply_error(impl_->handle.get(), detail::borrow(payload)), impl_->key);
}

Queryable Session::declare_queryable(std::string_view key, std::function<void(Query&&)> callback,
                                     bool complete) {
  auto impl = std::make_unique<Queryable::Impl>();
  impl->session = impl_;
  void* context = QueryClosure::make(std::move(callback), impl_->errors);
  zloam_queryable* handle = nullptr;
  detail::check(
      zloam_session_declare_queryable(impl_->handle.get(), detail::slice(key), complete,
                                      call_with_query, context, QueryClosure::drop, &handle),
      key);
  impl->handle.reset(handle);
  return Queryable(std::move(impl));
}

void Session::get(std::string_view selector, std::function<void(Reply&&)> on_reply,
                  std::function<void()> on_done, const GetOptions& options) {
  detail::start_get({std::move(on_reply), std::move(on_done)}, impl_->errors, selector,
                    [&](void* context) {
                      return zloam_session_get(impl_->handle.get(), detail::slice(selector),
                                               detail::borrow(options.payload),
                                               detail::to_ms(options.timeout), options.target_all,
                                               detail::call_with_reply, context, detail::drop_get);
                    });
}

std::vector<Reply> Session::get(std::string_view selector, const GetOptions& options) {
  detail::ReplyCollector collector;
  get(selector, collector.on_reply(), collector.on_done(), options);
  return collector.wait(options.timeout);
}

}  // namespace zloam::zenoh
