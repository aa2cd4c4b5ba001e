#pragma once
// A get whose answers are collected, in the background or while the caller waits.

#include <chrono>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "common/runtime/shared.hpp"
#include "common/zenoh/zenoh.hpp"

namespace zloam::runtime {

class AsyncGet {
 public:
  static constexpr std::chrono::nanoseconds kEndless = std::chrono::nanoseconds::max();

  bool started() const { return state_ != nullptr; }

  void start(zenoh::Session& session, const std::string& selector,
             std::chrono::milliseconds timeout, const std::shared_ptr<Shared>& shared,
             zenoh::Bytes payload = {}) {
    state_ = std::make_shared<State>();
    zenoh::GetOptions options;
    options.timeout = timeout;
    options.payload = std::move(payload);
    session.get(
        selector,
        [state = state_](zenoh::Reply&& reply) {
          const std::lock_guard lock(state->mutex);
          if (!reply.ok()) return;
          state->samples.push_back(std::move(*reply.sample));
          state->heard_ns = steady_ns();
        },
        [state = state_, shared] {
          {
            const std::lock_guard lock(state->mutex);
            state->done = true;
          }
          shared->notify();
        },
        options);
  }

  /// The samples once all have arrived; then started() is false again. Earlier if some have arrived
  /// and no more came for `quiet`: a hanging responder never ends its answer.
  std::optional<std::vector<zenoh::Sample>> take(std::chrono::nanoseconds quiet = kEndless) {
    if (!state_) return std::nullopt;
    std::vector<zenoh::Sample> samples;
    {
      const std::lock_guard lock(state_->mutex);
      const std::int64_t silent_ns = steady_ns() - state_->heard_ns;
      if (!state_->done && (state_->samples.empty() || silent_ns < quiet.count())) {
        return std::nullopt;
      }
      samples = std::move(state_->samples);
    }
    state_.reset();
    return samples;
  }

 private:
  struct State {
    std::mutex mutex;
    std::vector<zenoh::Sample> samples;
    std::int64_t heard_ns = 0;
    bool done = false;
  };
  std::shared_ptr<State> state_;
};

/// The same, waiting until all have arrived, or for `quiet` as above.
inline std::vector<zenoh::Sample> get_and_wait(
    zenoh::Session& session, const std::string& selector, std::chrono::milliseconds timeout,
    std::chrono::nanoseconds quiet = AsyncGet::kEndless) {
  constexpr std::int64_t kLook_ns = 100 * kMs;
  const auto bell = std::make_shared<Shared>();
  AsyncGet get;
  get.start(session, selector, timeout, bell);
  while (true) {
    if (auto samples = get.take(quiet)) return std::move(*samples);
    bell->wait_until(steady_ns() + kLook_ns);
  }
}

}  // namespace zloam::runtime
