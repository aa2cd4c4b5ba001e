#include "common/zenoh/detail.hpp"

namespace zloam::zenoh {

static_assert(sizeof(zloam_slice) == 16 && sizeof(zloam_sample) == 56);
static_assert(sizeof(zloam_publisher_options) == 24 && sizeof(zloam_query_view) == 40);

namespace detail {

void check(zloam_status status, std::string_view doing) {
  if (status == ZLOAM_OK) return;
  throw ZenohError(std::string(doing) + ": " + zloam_last_error());
}

void CallbackErrors::report(std::string_view what) noexcept {
  ++count_;
  try {
    Session::ErrorHandler handler;
    {
      const std::lock_guard lock(mutex_);
      handler = handler_;
    }
    if (handler) handler(what);
  } catch (...) {  // A handler that throws cannot be told of it.
  }
}

void CallbackErrors::set_handler(Session::ErrorHandler handler) {
  const std::lock_guard lock(mutex_);
  handler_ = std::move(handler);
}

}  // namespace detail

void init_log(std::string_view fallback_level) {
  detail::check(zloam_init_log(detail::slice(fallback_level)), "log");
}

}  // namespace zloam::zenoh
