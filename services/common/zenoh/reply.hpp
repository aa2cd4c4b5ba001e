#pragma once
// The receiving end of a get, for data and for liveliness. Not for other folders.

#include <condition_variable>

#include "common/zenoh/detail.hpp"

namespace zloam::zenoh::detail {

struct GetCallbacks {
  std::function<void(Reply&&)> on_reply;
  std::function<void()> on_done;
};

/// Calls on_done when both have happened: the get was started without an error, and Zenoh has
/// dropped its closure. Zenoh may do so before the starting call returns, and does when that fails.
class GetState {
 public:
  GetState(GetCallbacks callbacks, std::shared_ptr<CallbackErrors> errors)
      : callbacks_(std::move(callbacks)), errors_(std::move(errors)) {}
  void reply(const zloam_sample* sample, zloam_bytes* error) noexcept;
  void event() noexcept;

 private:
  GetCallbacks callbacks_;
  std::shared_ptr<CallbackErrors> errors_;
  std::atomic<int> missing_{2};
};

void call_with_reply(void* context, const zloam_sample* sample, zloam_bytes* error) noexcept;
void drop_get(void* context) noexcept;

/// start(context) is the call into Rust, with call_with_reply and drop_get.
void start_get(GetCallbacks callbacks, std::shared_ptr<CallbackErrors> errors,
               std::string_view doing, const std::function<zloam_status(void*)>& start);

std::uint64_t to_ms(std::chrono::milliseconds timeout);

/// Waits for the end of a get and returns its replies. A get ends after its timeout; if the session
/// is closed meanwhile Zenoh may not report the end, so the wait then ends kGrace later.
class ReplyCollector {
 public:
  std::function<void(Reply&&)> on_reply();
  std::function<void()> on_done();
  std::vector<Reply> wait(std::chrono::milliseconds timeout);
  static constexpr std::chrono::milliseconds kGrace{2000};

 private:
  struct State {
    std::mutex mutex;
    std::condition_variable ended;
    std::vector<Reply> replies;
    bool done = false;
  };
  std::shared_ptr<State> state_ = std::make_shared<State>();
};

}  // namespace zloam::zenoh::detail
