#include <sstream>

#include "common/zenoh/session_impl.hpp"

namespace zloam::zenoh {

Session::Impl::~Impl() {
  try {
    close(std::chrono::milliseconds(3000));
  } catch (
      const ZenohError&) {  // A destructor can't report the error; the process frees what is left.
  }
}

bool Session::Impl::close(std::chrono::milliseconds deadline) {
  {
    const std::lock_guard lock(mutex);
    if (closed || !handle) return true;
  }
  bool in_time = false;
  const auto ms = static_cast<std::uint64_t>(std::max<std::int64_t>(deadline.count(), 0));
  detail::check(zloam_session_close(handle.get(), ms, &in_time), "close");
  const std::lock_guard lock(mutex);
  closed = in_time;
  return in_time;
}

Session::Session(std::shared_ptr<Impl> impl) : impl_(std::move(impl)) {}
Session::Session(Session&&) noexcept = default;
Session& Session::operator=(Session&&) noexcept = default;
Session::~Session() = default;

Session Session::open(const Config& config) {
  zloam_session* handle = nullptr;
  detail::check(zloam_session_open(detail::borrow(config), &handle), "open");
  detail::Handle<zloam_session, zloam_session_drop> owned(handle);
  auto impl = std::make_shared<Impl>();
  impl->handle = std::move(owned);
  return Session(std::move(impl));
}

bool Session::close(std::chrono::milliseconds deadline) { return impl_->close(deadline); }

std::string Session::zid() const {
  std::string digits(32, '\0');
  auto* buffer = reinterpret_cast<std::uint8_t*>(digits.data());
  digits.resize(zloam_session_zid(impl_->handle.get(), buffer, digits.size()));
  return digits;
}

std::vector<std::string> Session::links() const {
  std::string text;
  const auto read = [&] {
    auto* buffer = reinterpret_cast<std::uint8_t*>(text.data());
    return zloam_session_links(impl_->handle.get(), buffer, text.size());
  };
  // Read again if a link that came up between two calls has made the text longer.
  for (std::size_t size = read(); size != text.size(); size = read()) text.resize(size);
  std::vector<std::string> ends;
  std::istringstream lines(text);
  for (std::string end; std::getline(lines, end);) ends.push_back(end);
  return ends;
}

void Session::set_error_handler(ErrorHandler handler) {
  impl_->errors->set_handler(std::move(handler));
}

std::uint64_t Session::callback_exceptions() const { return impl_->errors->count(); }

}  // namespace zloam::zenoh
