#pragma once
// Samples of a key, held until they are taken. It is subscribed to only while they are wanted:
// stages then skip the work for data that has no readers.

#include <deque>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <utility>

#include "common/zenoh/zenoh.hpp"

namespace zloam::runtime {

/// Passes the newest samples from Zenoh's threads to the worker.
class Mailbox {
 public:
  explicit Mailbox(std::size_t newest) : newest_(newest) {}

  /// A subscriber's callback; may outlive the mailbox.
  std::function<void(zenoh::Sample&&)> sink() const {
    return [box = box_, newest = newest_](zenoh::Sample&& sample) {
      const std::lock_guard lock(box->mutex);
      box->samples.push_back(std::move(sample));
      if (box->samples.size() > newest) box->samples.pop_front();
    };
  }

  std::deque<zenoh::Sample> take() {
    const std::lock_guard lock(box_->mutex);
    return std::exchange(box_->samples, {});
  }

 private:
  struct Box {
    std::mutex mutex;
    std::deque<zenoh::Sample> samples;
  };
  std::size_t newest_;
  std::shared_ptr<Box> box_ = std::make_shared<Box>();
};

class OnDemand {
 public:
  /// `newest`: number of samples held until they are taken.
  OnDemand(zenoh::Session& session, std::string key, std::size_t newest)
      : session_(session), key_(std::move(key)), box_(newest) {}

  /// True when the subscription begins now.
  bool want(bool wanted) {
    if (!wanted) subscriber_.reset();
    if (!wanted || subscriber_) return false;
    subscriber_ = session_.declare_subscriber(key_, box_.sink());
    return true;
  }

  std::deque<zenoh::Sample> take() { return box_.take(); }

 private:
  zenoh::Session& session_;
  std::string key_;
  Mailbox box_;
  std::optional<zenoh::Subscriber> subscriber_;
};

}  // namespace zloam::runtime
