#include "common/zenoh/reply.hpp"

#include <algorithm>

namespace zloam::zenoh::detail {

namespace {
using Context = std::shared_ptr<GetState>;
}

void GetState::reply(const zloam_sample* sample, zloam_bytes* error) noexcept {
  contain(*errors_, [&] {
    Reply reply;
    reply.error = adopt(error);
    if (sample != nullptr) reply.sample = to_sample(*sample);
    callbacks_.on_reply(std::move(reply));
  });
}

void GetState::event() noexcept {
  if (missing_.fetch_sub(1) != 1) return;
  contain(*errors_, [&] {
    if (callbacks_.on_done) callbacks_.on_done();
  });
}

void call_with_reply(void* context, const zloam_sample* sample, zloam_bytes* error) noexcept {
  take_over(context);
  (*static_cast<Context*>(context))->reply(sample, error);
  hand_over(context);
}

void drop_get(void* context) noexcept {
  take_over(context);
  const std::unique_ptr<Context> owned(static_cast<Context*>(context));
  (*owned)->event();
}

void start_get(GetCallbacks callbacks, std::shared_ptr<CallbackErrors> errors,
               std::string_view doing, const std::function<zloam_status(void*)>& start) {
  const auto state = std::make_shared<GetState>(std::move(callbacks), std::move(errors));
  auto* context = new Context(state);
  hand_over(context);
  check(start(context), doing);
  state->event();
}

std::uint64_t to_ms(std::chrono::milliseconds timeout) {
  return static_cast<std::uint64_t>(std::max<std::int64_t>(timeout.count(), 1));
}

std::function<void(Reply&&)> ReplyCollector::on_reply() {
  return [state = state_](Reply&& reply) {
    const std::lock_guard lock(state->mutex);
    state->replies.push_back(std::move(reply));
  };
}

std::function<void()> ReplyCollector::on_done() {
  return [state = state_] {
    {
      const std::lock_guard lock(state->mutex);
      state->done = true;
    }
    state->ended.notify_all();
  };
}

std::vector<Reply> ReplyCollector::wait(std::chrono::milliseconds timeout) {
  std::unique_lock lock(state_->mutex);
  state_->ended.wait_for(lock, timeout + kGrace, [&] { return state_->done; });
  return std::move(state_->replies);
}

}  // namespace zloam::zenoh::detail
