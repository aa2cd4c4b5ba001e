#pragma once
// The inside of a Session, shared by the files that declare entities on it. Not for other folders.

#include "common/zenoh/detail.hpp"

namespace zloam::zenoh {

/// Entities hold a reference, so that Zenoh's session stays open as long as one of them lives.
struct Session::Impl {
  ~Impl();
  bool close(std::chrono::milliseconds deadline);

  detail::Handle<zloam_session, zloam_session_drop> handle;
  std::shared_ptr<detail::CallbackErrors> errors = std::make_shared<detail::CallbackErrors>();
  std::mutex mutex;  // guards the members below
  bool closed = false;
};

struct Subscriber::Impl {
  std::shared_ptr<Session::Impl> session;  // destroyed after the handle
  detail::Handle<zloam_subscriber, zloam_subscriber_drop> handle;
};

namespace detail {
const zloam_config* borrow(const Config& config);
}  // namespace detail

}  // namespace zloam::zenoh
