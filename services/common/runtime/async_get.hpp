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
          if (!reply.ok()) {
            if (state->error.empty()) state->error = reply.error.to_string();
            return;
          }
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

  /// The samples once all have arrived; then started() is false again. Earlier if none has arrived
  /// within `first`, or some have and no more came for `quiet`: a hanging responder never ends its
  /// answer.
  std::optional<std::vector<zenoh::Sample>> take(std::chrono::nanoseconds quiet = kEndless,
                                                 std::chrono::nanoseconds first = kEndless) {
    if (!state_) return std::nullopt;
    std::vector<zenoh::Sample> samples;
    {
      const std::lock_guard lock(state_->mutex);
      const std::int64_t silent_ns = steady_ns() - state_->heard_ns;
      const std::int64_t most_ns = state_->samples.empty() ? first.count() : quiet.count();
      if (!state_->done && silent_ns < most_ns) return std::nullopt;
      samples = std::move(state_->samples);
      error_ = state_->error;
      ended_ = state_->done;
    }
    state_.reset();
    return samples;
  }

  /// Why answers taken last are not all that there are, by a responder or because the time was up;
  /// empty: they are.
  const std::string& error() const { return error_; }
  /// False: those taken last were taken before all responders had ended their answers.
  bool ended() const { return ended_; }

 private:
  struct State {
    std::mutex mutex;
    std::vector<zenoh::Sample> samples;
    std::string error;
    /// of the last sample; before it, of the question
    std::int64_t heard_ns = steady_ns();
    bool done = false;
  };
  std::shared_ptr<State> state_;
  std::string error_;
  bool ended_ = true;
};

struct Answers {
  std::vector<zenoh::Sample> samples;
  /// as AsyncGet::error() and ended()
  std::string error;
  bool ended = true;
};

/// The same, waiting until all have arrived, or as take() describes.
inline Answers get_and_wait(zenoh::Session& session, const std::string& selector,
                            std::chrono::milliseconds timeout,
                            std::chrono::nanoseconds quiet = AsyncGet::kEndless,
                            std::chrono::nanoseconds first = AsyncGet::kEndless) {
  constexpr std::int64_t kLook_ns = 100 * kMs;
  const auto bell = std::make_shared<Shared>();
  AsyncGet get;
  get.start(session, selector, timeout, bell);
  while (true) {
    if (auto samples = get.take(quiet, first))
      return {std::move(*samples), get.error(), get.ended()};
    bell->wait_until(steady_ns() + kLook_ns);
  }
}

}  // namespace zloam::runtime
