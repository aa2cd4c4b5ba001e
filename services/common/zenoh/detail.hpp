#pragma once
// Shared by the .cpp files of this folder: handles of the C ABI, errors, and the conversion from a
// C callback to a std::function. Not for other folders.

#include <atomic>
#include <mutex>

#include "common/zenoh/bridge/include/zloam_zenoh.h"
#include "common/zenoh/tsan.hpp"
#include "common/zenoh/zenoh.hpp"

namespace zloam::zenoh::detail {

template <class T, void (*drop)(T*)>
struct Drop {
  void operator()(T* handle) const noexcept { drop(handle); }
};
template <class T, void (*drop)(T*)>
using Handle = std::unique_ptr<T, Drop<T, drop>>;

/// Throws ZenohError with the text of the failed call, prefixed by what was being done.
void check(zloam_status status, std::string_view doing);

inline zloam_slice slice(std::string_view text) {
  return {reinterpret_cast<const std::uint8_t*>(text.data()), text.size()};
}
inline std::string_view text(zloam_slice slice) {
  return {reinterpret_cast<const char*>(slice.data), slice.size};
}

/// Takes ownership of the handle, which may be null.
Bytes adopt(zloam_bytes* handle);
/// The handle inside, or null for no bytes.
const zloam_bytes* borrow(const Bytes& bytes);
/// Takes ownership of the payload and the attachment.
Sample to_sample(const zloam_sample& view);

/// Exceptions thrown by callbacks of one session; outlives the session until its last callback.
class CallbackErrors {
 public:
  void report(std::string_view what) noexcept;
  void set_handler(Session::ErrorHandler handler);
  std::uint64_t count() const { return count_; }

 private:
  std::atomic<std::uint64_t> count_{0};
  std::mutex mutex_;
  Session::ErrorHandler handler_;
};

/// Runs f; passes an exception to errors.
template <class F>
void contain(CallbackErrors& errors, F&& f) noexcept {
  try {
    f();
  } catch (const std::exception& error) {
    errors.report(error.what());
  } catch (...) {
    errors.report("unknown exception");
  }
}

/// The context of a C closure. Zenoh frees it by drop() after the last call.
template <class State>
struct Closure {
  State state;
  std::shared_ptr<CallbackErrors> errors;

  /// Makes the context for Rust, which owns it from then on.
  static void* make(State state, std::shared_ptr<CallbackErrors> errors) {
    auto* closure = new Closure{std::move(state), std::move(errors)};
    hand_over(closure);
    return closure;
  }
  /// Runs f(state) for a call with this context.
  template <class F>
  static void call(void* context, F&& f) noexcept {
    take_over(context);
    auto* closure = static_cast<Closure*>(context);
    contain(*closure->errors, [&] { f(closure->state); });
    hand_over(context);
  }
  static void drop(void* context) noexcept {
    take_over(context);
    delete static_cast<Closure*>(context);
  }
};

using SampleClosure = Closure<std::function<void(Sample&&)>>;
void call_with_sample(void* context, const zloam_sample* sample) noexcept;

}  // namespace zloam::zenoh::detail
